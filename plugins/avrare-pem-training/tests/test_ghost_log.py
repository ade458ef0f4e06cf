"""False detections in a log: read, fitted, and drawn again as they were."""

import csv
import math

import numpy as np
import pytest

from avrare.base.errors import UsageError
from avrare.cli.main import main
from avrare_gp_pem.config import GpPemConfig, ParametricPemConfig
from avrare_gp_pem.runtime.models import build_gp, build_parametric
from avrare_gp_pem.runtime.store import load
from avrare_pem_training.ghost_log import GhostLog, fit_ghosts
from avrare_pem_training.table import read_log, read_table

HEADER = "right,forward,yaw,length,width,detected,error_right,error_forward,track,time,ghost"
CAR = "1,20,1.5,4.5,1.8,1,0.1,0.2,1"
GHOSTS = {"rate": 0.4, "persistence": 0.6, "forward": (5.0, 35.0), "left": (-6.0, 2.0)}
LASTING = {"detection": 0.6, "position": 0.4}


def write(path, *rows):
    path.write_text("\n".join([HEADER, *rows]) + "\n")
    return path


def test_ghosts_are_read_apart_from_vehicles(tmp_path):
    rows, ghosts = read_log(write(tmp_path / "a.csv", f"{CAR},0,0", "3,30,,,,1,,,7,0,1", f"{CAR},0.5,"))
    assert len(rows) == len(read_table(tmp_path / "a.csv")) == 2
    assert (ghosts.right.tolist(), ghosts.forward.tolist(), ghosts.track.tolist()) == ([3.0], [30.0], [7.0])
    np.testing.assert_array_equal(ghosts.frames, [0.0, 0.5])
    assert read_log(write(tmp_path / "b.csv", f"{CAR},0,0"))[1] is None


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ("3,30,,,,1,,,7,,1", "3: time: is missing"),
        ("3,,,,,1,,,7,0,1", "3: right, forward: a false detection has no place"),
        ("3,30,,,,1,,,7,0,2", "3: ghost: is implausible"),
        ("3,30,,,,1,,,7,0,0", "3: yaw: is missing"),
        ("3,3000,,,,1,,,7,0,1", "3: forward: 3000 is implausible: metres"),
        ("3,30,,,,1,,,-7,0,1", "3: track: -7 is implausible"),
        ("3,30,,,,1,,,7,inf,1", "3: time: inf is implausible"),
        ("3,30,,,,1,,,7,-0.1,1", "3: time: is before that of the row above"),
    ],
)
def test_rows_that_cannot_be_are_refused(tmp_path, row, message):
    with pytest.raises(UsageError, match=message):
        read_log(write(tmp_path / "a.csv", f"{CAR},0,0", row))


def test_few_ghosts_and_ghosts_without_tracks():
    rng = np.random.default_rng(0)
    frames = 0.1 * np.arange(300)
    time = rng.choice(frames, 60)
    log = GhostLog(rng.normal(size=60), rng.uniform(5, 9, 60), np.full(60, np.nan), time, frames)
    found = fit_ghosts(log)
    assert found.persistence == 0.0
    assert found.rate == pytest.approx(0.2)
    assert len(found.points) == 60
    assert fit_ghosts(log.split(0.1)[0]) is None
    parts = log.split(0.8)
    assert [len(part.frames) for part in parts] == [240, 60]
    assert sum(len(part.time) for part in parts) == 60


def ghost_log(make, options, rollouts=400, steps=60):
    """Return the false detections of many drives, 100 s apart from one another."""
    model = build_parametric(ParametricPemConfig(ghosts=options), make.scene(1))
    world = make.world([[20.0, 0.0, 0.0]], n=rollouts)
    rng = np.random.default_rng(7)
    memory = model.start(rng.standard_normal((rollouts, model.noise_size)))
    number, found = np.zeros((rollouts, 3)), []
    for step in range(steps):
        before = memory.forward
        seen, memory = model.follow(world, rng.standard_normal((rollouts, model.noise_size)), memory)
        number += memory.forward != before
        drive, slot = np.nonzero(memory.present)
        track = 1000 * (3 * drive + slot) + number[drive, slot]
        time = np.round(100.0 * drive + 0.1 * step, 1)
        found.append([-seen.y[drive, 1 + slot], seen.x[drive, 1 + slot], track, time])
    frames = np.round(100.0 * np.arange(rollouts)[:, None] + 0.1 * np.arange(steps), 1).reshape(-1)
    return GhostLog(*np.concatenate(found, axis=1), frames)


@pytest.mark.parametrize("persistence", [0.6, 0.0])
def test_rate_and_persistence_of_a_long_log_are_found(make, persistence):
    found = fit_ghosts(ghost_log(make, GHOSTS | {"persistence": persistence}))
    assert found.rate == pytest.approx(0.4, rel=0.1)  # four standard errors
    assert found.persistence == pytest.approx(persistence, rel=0.1)
    forward, left = found.points.T
    assert forward.mean() == pytest.approx(20.0, abs=4 * 8.7 / math.sqrt(len(forward)))
    assert left.mean() == pytest.approx(-2.0, abs=4 * 2.3 / math.sqrt(len(left)))


def drives(make, rollouts=40, steps=110):
    """Return lines of a log of several drives, with the truth of GHOSTS and LASTING; 4 in 5 are detected."""
    config = ParametricPemConfig(ghosts=GHOSTS, persistence=LASTING, detection_plateau=0.8)
    model = build_parametric(config, make.scene(3))
    rng = np.random.default_rng(3)
    bearing = rng.uniform(-0.5, 0.5, (rollouts, 3)) + 2 * np.arange(3)  # so that none hides another
    place = rng.uniform(8, 25, (rollouts, 3, 1)) * np.stack([np.cos(bearing), np.sin(bearing)], axis=-1)
    heading = rng.uniform(-np.pi, np.pi, (rollouts, 3))
    memory = model.start(rng.standard_normal((rollouts, model.noise_size)))
    number, lines = np.zeros((rollouts, 3), int), [[] for _ in range(rollouts)]
    for step in range(steps):
        noise = rng.standard_normal((rollouts, model.noise_size))
        before, place = memory.forward, place + 0.01  # rows of the same box would be dropped as duplicates
        world = make.world(np.concatenate([place, heading[..., None]], axis=-1))
        seen, memory = model.follow(world, noise, memory)
        number += memory.forward != before
        for drive in range(rollouts):
            time = round(100.0 * drive + 0.1 * step, 1)
            for car in range(3):
                x, y = place[drive, car]
                hit = bool(seen.detected[drive, car])
                errors = [y - seen.y[drive, car], x - seen.x[drive, car]] if hit else ["", ""]
                errors[0] = -errors[0] if hit else ""
                pose = [-y, x, heading[drive, car] + np.pi / 2, 4.5, 1.8, int(hit), *errors]
                lines[drive].append([*pose, 3 * drive + car, time, 0])
            for slot in np.flatnonzero(seen.detected[drive, 3:]):
                at = [-seen.y[drive, 3 + slot], seen.x[drive, 3 + slot], "", "", "", 1, "", ""]
                track = 1000 * (3 * drive + slot) + number[drive, slot]
                lines[drive].append([*at, track, time, 1])
    return [line for drive in lines for line in drive]


@pytest.mark.slow
def test_the_truth_of_a_log_is_recovered(make, tmp_path, capsys):
    with (tmp_path / "log.csv").open("w", newline="") as file:
        csv.writer(file).writerows([HEADER.split(","), *drives(make)])
    words = ["pem", "fit", str(tmp_path / "log.csv"), "--model", "logistic", "--out", str(tmp_path)]
    assert main([*words, "--artefact", "no"]) == 0
    model = load(tmp_path / "model.npz")
    assert model.ghosts.rate == pytest.approx(0.4, rel=0.3)  # four standard errors of so short a log
    assert model.ghosts.persistence == pytest.approx(0.6, rel=0.25)
    forward, left = model.ghosts.points.T
    assert forward.mean() == pytest.approx(20.0, abs=2.5)
    assert left.mean() == pytest.approx(-2.0, abs=0.7)
    rows = read_table(tmp_path / "log.csv")
    assert model.clean.law(rows, 0.0).detect.mean() == pytest.approx(0.78, abs=0.04)
    assert model.persistence.detection[0] == pytest.approx(0.6, rel=0.3)
    assert model.persistence.position[0] == pytest.approx(0.4, rel=0.3)
    assert max(model.persistence.detection[1], model.persistence.position[1]) < 0.15  # nothing lasts for good
    card = (tmp_path / "model.md").read_text()
    assert "False detections: 0." in card
    assert "Only with `ghosts: measured`" in card

    config = GpPemConfig(model=str(tmp_path / "model.npz"), ghosts="measured", persistence="measured")
    again = build_gp(config, make.scene(2))
    law = again.ghosts
    assert law.stay == pytest.approx(math.exp(-0.1 / 0.6), rel=0.03)
    noise = np.random.default_rng(4).standard_normal((3000, again.noise_size))
    seen = again.observe(make.world([[20.0, 0.0, 0.0], [30.0, 3.0, 0.0]], n=3000), noise)
    assert seen.detected[:, 2:].sum(axis=1).mean() == pytest.approx(law.rate, rel=0.15)
