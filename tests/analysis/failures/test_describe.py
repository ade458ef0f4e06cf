"""Disturbances in words."""

import numpy as np
import pytest

from avrare.analysis.failures.noise_description import (
    Disturbance,
    describe,
    find_disturbances,
    join_disturbances,
)
from avrare.rollout.replay import replay_tape, tabulate_signals

MISSED = 9.0
"""Noise of rank one: nobody is detected with it."""


@pytest.fixture
def tape():
    return np.zeros((9, 4))


def test_a_missed_vehicle(drive_past, tape):
    tape[2:5, 0] = tape[7, 0] = MISSED
    assert (
        describe(drive_past.problem("near"), tape)
        == "parked missed from t = 0.2 to 0.4 s, then missed at t = 0.7 s"
    )


def test_errors_say_how_far_where_and_when(drive_past, tape):
    tape[3, 1] = 3.0
    tape[5:7, 2] = [3.0, 2.9]
    found = find_disturbances(drive_past.problem("near"), tape)
    assert [phrase.vehicle for phrase in found] == ["parked", "parked"]
    assert [phrase.step for phrase in found] == [3, 5]
    assert found[0].text.endswith("m too far behind at t = 0.3 s")
    assert found[1].text.endswith("m too far right from t = 0.5 to 0.6 s")
    tape[5:7, 2] *= -1.0
    assert "m too far left from t = 0.5 to 0.6 s" in describe(drive_past.problem("near"), tape)
    lateral = float(find_disturbances(drive_past.problem("near"), tape)[1].text.split()[0])
    scene = drive_past.scene
    assert 0.1 < lateral < 10.0 * scene.widths[0]


def test_small_noise_is_described_as_noise(drive_past, tape):
    tape[4, 3] = 0.01
    assert describe(drive_past.problem("near"), tape) == "channel 3 at step 4: +0.01 sigma"


def test_no_noise(drive_past, tape):
    assert describe(drive_past.problem("near"), tape) == "nothing is disturbed"


def test_a_system_without_perception_is_described_by_channels(linear):
    tape = np.zeros((21, 6))
    tape[10:15, 2] = [1.0, 2.0, 3.14, 2.0, 1.0]
    tape[0, 5] = -2.0
    expected = "channel 5 at step 0: -2 sigma, then channel 2 at steps 10-14: +3.1 sigma"
    assert describe(linear.problem(linear.specifications), tape) == expected


def test_the_smallest_of_many_disturbances_are_only_counted():
    found = [Disturbance("van", f"p{k}", k, float(k)) for k in range(10)]
    assert (
        join_disturbances(found)
        == "van " + ", then ".join(f"p{k}" for k in range(2, 10)) + ", and 2 smaller ones"
    )


def test_numbered_cars_are_cars(drive_past):
    found = [
        Disturbance("car 13", "missed at t = 0.1 s", 1, 1.0),
        Disturbance("", "channel 2 at step 4: +1 sigma", 4, 1.0),
    ]
    assert join_disturbances(found) == "car 13 missed at t = 0.1 s, then channel 2 at step 4: +1 sigma"


def test_signals_of_vehicles_are_named_by_vehicle(drive_past, tape):
    columns, values = tabulate_signals(
        replay_tape(drive_past.problem("near"), tape).signals, drive_past.scene
    )
    assert "others_x[parked]" in columns
    assert values.shape == (9, len(columns))
    assert (values[:, columns.index("others_x[parked]")] == 40.0).all()
