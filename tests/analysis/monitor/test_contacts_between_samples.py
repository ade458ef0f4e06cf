"""Recorded vehicles that pass through each other between two samples."""

import numpy as np
import pytest

from avrare.driving import Road
from avrare.results.recordings import VehicleTrack, assemble_recording
from avrare.stack.builder import build_rule

ROAD = Road((0.0, 3.5), 3.5)


def drive(x, speed, y=0.0, length=2.5):
    steps = 0.1 * np.arange(8)
    states = np.stack([x + speed * steps, np.full(8, y), np.zeros(8), np.full(8, speed), np.zeros(8)])
    return VehicleTrack(f"at_{x:g}", length, 1.8, np.ones(8, dtype=bool), states)


def judge(*others):
    recording = assemble_recording("own", 0.1, 0.0, drive(0.0, 40.0), others, ROAD)
    rule = build_rule("no_collision", [], recording.scene)
    state = rule.start(1)
    for sample in range(recording.samples):
        signals = {name: values[sample : sample + 1] for name, values in recording.signals.items()}
        state, verdict = rule.update(state, signals)
    return bool(verdict.violated[0]), recording


@pytest.mark.parametrize("apart", np.arange(20.0, 28.0, 0.5))
def test_two_short_cars_head_on_collide(apart):
    violated, recording = judge(drive(apart, -40.0))
    assert violated
    assert recording.signals["distance"].min() <= 0.0
    assert recording.signals["gap"].min() <= 0.0


def test_cars_in_two_lanes_and_one_that_vanishes_do_not():
    violated, recording = judge(drive(24.0, -40.0, y=3.5))
    assert not violated
    np.testing.assert_allclose(recording.signals["ego_x"], 4.0 * np.arange(8))
    gone = drive(24.0, -40.0)
    gone.present[3:] = False
    assert not judge(gone)[0]
