"""Many drives: what is counted, and that neither the way nor the number of processes matters."""

import json
import math

import numpy as np
import pytest

from avrare.analysis.monitor import long_recordings
from avrare.analysis.monitor.monitoring import describe_body, monitor_recording
from avrare.cli.main import main
from avrare.driving import Road
from avrare.results.recordings import VehicleTrack, assemble_recording
from avrare.stack.builder import build_rule
from avrare_recordings.batch import Question, monitor_files

ROAD = Road((1.75, 5.25), 3.5)
STEPS = 40


def crowd(rng, count, steps=STEPS):
    """Place an ego among cars at random, so that rules are broken and kept."""

    def track(name, lane, x, speed):
        y = ROAD.lane_centres[lane] + rng.normal(0.0, 0.2, steps)
        states = np.stack([x + speed * 0.1 * np.arange(steps), y, np.zeros(steps), np.full(steps, speed)])
        states = np.concatenate([states, rng.normal(0.0, 1.0, (1, steps))])
        return VehicleTrack(name, 4.5, 1.8, np.ones(steps, dtype=bool), states)

    others = [track(f"v{i}", i % 2, rng.uniform(-60, 60), rng.uniform(5, 25)) for i in range(count)]
    return assemble_recording("crowd", 0.1, 0.0, track("e", 0, 0.0, 18.0), others, ROAD)


@pytest.mark.parametrize("rule", ["R_G1", "R_G2", "R_I2", "R_I5", "R_G4"])
def test_stretches_give_what_the_whole_gives(rule, monkeypatch):
    recording = crowd(np.random.default_rng(3), 7)
    specification = build_rule(rule, ["cut_in_time=0.5"] if rule == "R_G1" else [], recording.scene)
    whole = monitor_recording(rule, specification, recording)
    monkeypatch.setattr(long_recordings, "LARGE", 1)
    monkeypatch.setattr(long_recordings, "_STRETCH", 7 * 49)
    parts = monitor_recording(rule, specification, recording)
    np.testing.assert_array_equal([whole.body, whole.prefix], [parts.body, parts.prefix])
    assert whole.first == parts.first
    assert (whole.worst.sample, whole.worst.vehicles) == (parts.worst.sample, parts.worst.vehicles)
    body, truth, first, worst = describe_body(specification, recording)
    np.testing.assert_array_equal(body, whole.body)
    assert truth.all() != whole.violated
    assert (first, worst.sample) == (whole.first, whole.worst.sample)


def write(path, gaps):
    """Write two cars in one lane: ``a`` so far behind ``b`` at each step, both at 20 m/s."""
    lines = ["time,vehicle,x,y,heading,speed,length,width"]
    for t, gap in enumerate(gaps):
        places = {"a": 2.0 * t, "b": 2.0 * t + 4 + gap}
        lines += [f"{0.1 * t:.1f},{name},{x},1.75,0,20,4,2" for name, x in places.items()]
    path.write_text("\n".join(lines) + "\n")


@pytest.fixture
def folder(tmp_path):
    write(tmp_path / "one.csv", [20, 5, 5, 20, 5, 20])  # 8.95 m are needed: two violations
    (tmp_path / "deeper").mkdir()
    write(tmp_path / "deeper" / "two.csv", [20.0] * 11)
    (tmp_path / "other.csv").write_text("time,speed\n0,1\n1,2\n")
    return tmp_path


def test_violations_hours_and_kilometres(folder):
    files = [str(folder / name) for name in ("one.csv", "deeper/two.csv", "other.csv")]
    found = monitor_files(files, Question(("R_G1", "R_I3"), road=ROAD))
    first, second = found.totals
    assert (first.drives, first.violated, first.violations) == (4, 1, 2)
    assert first.hours == pytest.approx((2 * 0.5 + 2 * 1.0) / 3600.0)
    assert first.kilometres == pytest.approx(20.0 * 3.0 / 1000.0)
    assert first.per_hour == pytest.approx(2 * 1200.0)
    assert first.per_kilometre == pytest.approx(2 / 0.06)
    assert second.violations == 0
    (worst,) = found.find_worst("R_G1")
    assert (worst.ego, worst.vehicles, worst.first) == ("a", "b", pytest.approx(0.1))
    assert [refusal.file for refusal in found.refusals] == [files[2]]
    assert math.isnan(found.scores[1].first)


def test_a_folder_on_the_command_line(folder, capsys):
    command = ["monitor", str(folder), "--rule", "R_G1", "--lanes", "1.75,5.25", "--out", str(folder / "out")]
    assert main(command) == 1
    shown = capsys.readouterr().out
    assert "one.csv ego a" in shown
    assert "not read" in shown
    rows = (folder / "out" / "monitor.csv").read_text().splitlines()
    assert len(rows) == 5
    assert main([*command[:-2], "--ego", "b", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert {score["ego"] for score in document["scores"]} == {"b"}


def test_every_vehicle_of_one_file(folder, capsys):
    words = ["--rule", "R_G1,R_I3", "--ego", "all", "--lanes", "1.75,5.25"]
    assert main(["monitor", str(folder / "one.csv"), *words]) == 1
    assert "R_I3" in capsys.readouterr().out


def test_what_does_not_go_together(folder, capsys):
    command = ["monitor", str(folder / "one.csv")]
    assert main([*command, "--rule", "R_G1", "--lanes", "1.75", "--workers", "2"]) == 4
    assert "--workers" in capsys.readouterr().err
    assert main([*command, "--stl", "always (x > 0)", "--ego", "all"]) == 4
    assert "--rule" in capsys.readouterr().err
