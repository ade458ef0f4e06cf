"""Monitored recording as text, bars, plot and files."""

import csv
import json

import numpy as np
import pytest

from avrare.analysis.monitor.cause_finder import DecisiveSample
from avrare.analysis.monitor.monitoring import MonitoringResult, summarise
from avrare.driving import Road
from avrare.output.plots.monitoring_plot import plot_monitoring
from avrare.results.recordings import Recording, VehicleTrack, assemble_recording
from avrare_recordings.output.monitoring_documents import monitoring_document, write_monitoring_csv
from avrare_recordings.output.monitoring_text import draw_chart, headline


def recording(samples=61, dt=0.1, start=0.0):
    return Recording("t.csv", dt, start, {"x": np.zeros(samples)})


def scored(body, first=None, worst=None, **changes):
    body = np.asarray(body, dtype=float)
    prefix = np.minimum.accumulate(body)
    fields = {"name": "R_G1", "formula": "always p", "recording": recording(len(body))} | changes
    fields |= {"prefix": prefix, "prefix_violated": prefix < 0.0, "body": body}
    return MonitoringResult(first=first, worst=worst, **fields)


FALLING = np.linspace(3.0, -1.0, 61)
CAUSE = DecisiveSample(46, -0.0667, {"o": "cut_in"}, "keeps_safe_distance(ego, cut_in)", -0.0667, 46)
WORST = DecisiveSample(60, -1.0, {"o": "cut_in"}, "keeps_safe_distance(ego, cut_in)", -1.0, 60)


def test_a_violation_in_one_sentence():
    found = summarise(scored(FALLING, CAUSE, WORST))
    cause = "keeps_safe_distance(ego, cut_in) has robustness -0.0667"
    assert found == f"R_G1 violated first at 4.6 s with cut_in: {cause} (worst robustness -1 at 6.0 s)"


def test_first_and_worst_at_once():
    one = DecisiveSample(46, -0.1, {"o": "cut_in"}, "safe(ego, cut_in) >= 0", -0.1, 46)
    body = np.r_[np.ones(46), -0.1, np.ones(14)]
    assert summarise(scored(body, one, one)) == (
        "R_G1 violated first and worst at 4.6 s with cut_in: safe(ego, cut_in) has robustness -0.1"
    )
    other = DecisiveSample(46, -0.1, {}, "p > 2", -3.0, 44)
    words = "at 4.6 s: at 4.4 s p > 2 has robustness -3 (overall robustness -0.1)"
    assert summarise(scored(body, other, other)) == f"R_G1 violated first and worst {words}"


def test_the_head_names_source_span_and_formula():
    lines = [str(line) for line in headline(scored(FALLING, formula="a(o) = p(o)\nalways " + "a " * 60))]
    assert lines[:3] == ["R_G1  t.csv", "61 samples, 0.1 s apart, 0.0 to 6.0 s", "  a(o) = p(o)"]
    assert lines[3].startswith("  always a a")
    assert max(len(part) for line in lines for part in line.splitlines()) <= 80


@pytest.mark.parametrize("samples", [2, 3, 40, 63, 64, 65, 1000])
def test_the_chart_fits_eighty_columns(samples):
    lines = [str(line) for line in draw_chart(scored(np.linspace(12.3456, -0.000123, samples)))]
    assert max(map(len, lines)) <= 80
    assert "12." in lines[1]
    assert any("-0.000123" in line for line in lines)
    assert lines[-1].split()[:2] == ["0.0", "s"]


def test_small_and_short_violations_are_visible():
    body = np.full(10_000, 50.0)
    body[7777] = -1e-9
    below = [str(line) for line in draw_chart(scored(body))][5:8]
    assert sum(line.count("█") for line in below) == 3
    assert all("█" not in str(line) for line in draw_chart(scored(np.full(10, -1.0)))[:1])


@pytest.mark.parametrize(
    ("body", "labels"),
    [
        ([np.inf, np.inf], {"inf"}),
        ([np.inf, 2.0], {"2"}),
        ([-np.inf, 1.0], {"-inf", "1"}),
        ([0.0, 0.0], set()),
    ],
)
def test_infinities_are_drawn(body, labels):
    lines = [str(line) for line in draw_chart(scored(body))]
    found = {line.split("▏")[0].strip() for line in lines if "▏" in line} - {"", "0"}
    assert found == labels


def test_plain_data_has_no_infinities():
    found = json.loads(json.dumps(monitoring_document(scored([np.inf, 1.0, -2.0], CAUSE, WORST))))
    assert found["body"] == [None, 1.0, -2.0]
    assert (found["verdict"], found["robustness"]) == ("broken", -2.0)
    assert found["first"]["vehicles"] == {"o": "cut_in"}
    assert found["first"]["time"] == pytest.approx(4.6)
    assert monitoring_document(scored([1.0, 2.0]))["first"] is None


def test_the_series_as_a_file(tmp_path):
    write_monitoring_csv(scored([2.0, 0.5, -1.0]), tmp_path / "m.csv")
    with open(tmp_path / "m.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["time"] for row in rows] == ["0", "0.1", "0.2"]
    assert [row["violated"] for row in rows] == ["false", "false", "true"]
    assert [float(row["robustness"]) for row in rows] == [2.0, 0.5, -1.0]


@pytest.mark.parametrize("road", [None, Road((0.0,), 3.5)])
def test_a_picture_with_and_without_a_road(tmp_path, road):
    there, states = np.ones(61, dtype=bool), np.zeros((5, 61))
    ego = VehicleTrack("ego", 4.0, 2.0, there, states)
    other = VehicleTrack("cut_in", 4.0, 2.0, ~there, states)
    found = assemble_recording("t.csv", 0.1, 0.0, ego, [other], road)
    body = FALLING.copy()
    body[:3] = np.inf
    plot_monitoring(scored(body, CAUSE, WORST, recording=found)).save(tmp_path / "m.png")
    assert (tmp_path / "m.png").read_bytes().startswith(b"\x89PNG")
