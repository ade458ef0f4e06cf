"""Disturbances in words."""

import numpy as np
import pytest

import avrare
from avrare.protocols import Misreading, System
from avrare.rollout.noise_words import (
    Disturbance,
    _Words,
    describe_tape,
    find_common_noise,
    find_disturbances,
    format_span,
    join_disturbances,
)
from avrare.rollout.replay import replay_tape, replay_tapes, tabulate_signals

MISSED = 9.0
"""Noise of rank one: nobody is detected with it."""


@pytest.fixture
def tape():
    return np.zeros((9, 4))


def find(problem, tape):
    return find_disturbances(problem, tape, replay_tape(problem, tape))


def test_a_missed_vehicle(drive_past, tape):
    tape[2:5, 0] = tape[7, 0] = MISSED
    assert (
        describe_tape(drive_past.problem("near"), tape)
        == "parked missed for 0.3 s from t = 0.2 s, then missed at t = 0.7 s"
    )


def test_errors_say_how_far_where_and_when(drive_past, tape):
    tape[3, 1] = 3.0
    tape[5:7, 2] = [3.0, 2.9]
    found = find(drive_past.problem("near"), tape)
    assert [each.subject for each in found] == ["parked", "parked"]
    assert [each.step for each in found] == [3, 5]
    assert found[0].text.endswith("m too far behind at t = 0.3 s")
    assert found[1].text.endswith("m too far right for 0.2 s from t = 0.5 s")
    tape[5:7, 2] *= -1.0
    assert "m too far left for 0.2 s from t = 0.5 s" in describe_tape(drive_past.problem("near"), tape)
    lateral = float(find(drive_past.problem("near"), tape)[1].text.removeprefix("up to ").split()[0])
    scene = drive_past.scene
    assert 0.1 < lateral < 10.0 * scene.widths[0]


def test_small_noise_is_described_as_noise(drive_past, tape):
    tape[4, 3] = 0.01
    assert describe_tape(drive_past.problem("near"), tape) == "speed error of parked +0.01 sigma at t = 0.4 s"


def test_no_noise(drive_past, tape):
    assert describe_tape(drive_past.problem("near"), tape) == "nothing is disturbed"


def test_a_system_without_perception_is_described_by_its_names(linear):
    tape = np.zeros((21, 6))
    tape[10:15, 2] = [1.0, 2.0, 3.14, 2.0, 1.0]
    tape[0, 5] = -2.0
    expected = (
        "measurement noise of y_seen -2 sigma at t = 0.0 s, "
        "then process noise of vx +4.1 sigma in sum for 0.5 s from t = 1.0 s"
    )
    assert describe_tape(linear.problem(linear.specifications), tape) == expected


def test_near_stretches_of_one_channel_are_one_and_tiny_ones_are_only_counted(linear):
    tape = np.zeros((21, 6))
    tape[[10, 12, 13], 2] = -1.0, -1.5, -1.0
    tape[[2, 18], 4] = 0.05
    text = describe_tape(linear.problem(linear.specifications), tape)
    assert text == "process noise of vx -1.8 sigma in sum for 0.4 s from t = 1.0 s, and 2 smaller ones"


class Radar(System):
    """Distance that a radar reads with an error that lasts: the sum of its noise."""

    noise_size, noise_names, dt = 2, ("radar", "wind"), 0.5

    def initial(self, noise):
        return {"error": 0.0 * noise[:, 0], "wind": noise[:, 1]}

    def step(self, state, noise):
        return {"error": state["error"] + noise[:, 0], "wind": noise[:, 1]}

    def signals(self, state):
        return {"read": 10.0 + state["error"]}

    def misreadings(self, state):
        words = "radar", "reads {} m too long", "reads {} m too short"
        return {"radar": Misreading(state["error"], *words)}


@pytest.fixture(scope="module")
def radar():
    return avrare.Problem(Radar(), avrare.stl("always (read < 13)"), steps=20)


def test_errors_that_a_system_declares_are_told_in_its_words(radar):
    tape = np.zeros((21, 2))
    tape[5, 0], tape[9, 0], tape[12, 1] = 1.9, -3.0, 2.0
    assert describe_tape(radar, tape) == (
        "radar reads 1.9 m too long for 2.0 s from t = 2.5 s, then reads 1.1 m too short for 6.0 s "
        "from t = 4.5 s, then wind +2 sigma at t = 6.0 s"
    )


def test_a_sample_is_told_in_the_same_words(radar):
    tapes = np.zeros((30, 21, 2))
    tapes[:, 1:4, 0] = 1.0 + np.linspace(-0.5, 0.5, 30)[:, None]
    tapes[:, :, 1] = np.where(np.arange(30) % 2, 3.0, -3.0)[:, None]
    found = find_common_noise(radar, tapes, replay_tapes(radar, tapes), np.full(30, 1 / 30), 30.0)
    texts = {each.subject: each.text for each in found}
    assert texts["radar"] == "reads 3 m too long for 10.0 s from t = 0.5 s"
    assert texts["wind"] == "3 times as large as usual to both sides for 10.5 s from t = 0.0 s"
    assert len(found) == 2


def test_an_error_that_grows_is_told_by_its_peak(radar):
    tape = np.zeros((21, 2))
    tape[[5, 9, 12, 15], 0] = 2.0, 2.0, 3.0, -7.0
    assert describe_tape(radar, tape) == "radar reads up to 7 m too long for 5.0 s from t = 2.5 s"


def test_drawn_options_are_told_by_their_mean_or_their_range(radar, monkeypatch):
    monkeypatch.setattr(_Words, "list_draws", lambda words, rollout: rollout)
    words = _Words(radar)
    words.names = ("draw of speed", "draw of gap", "draw of friction")
    scores = np.random.default_rng(1).standard_normal((60, 3)) * [1.0, 0.1, 1.0] + [1.5, 0.0, 0.0]
    rollouts = [[(20.0 + score, score) for score in row] for row in scores.tolist()]
    draws = words.find_common_draws(rollouts, np.full(60, 1 / 60), 60.0)
    speed, gap = [f"{each.subject} {each.text}" for each in draws]
    assert speed == f"speed is {20.0 + scores[:, 0].mean():.4g} ({scores[:, 0].mean():+.2g} sigma)"
    low, high = 20.0 + scores[:, 1].min(), 20.0 + scores[:, 1].max()
    assert gap == f"gap is between {low:.3g} and {high:.3g}"


def test_the_smallest_of_many_disturbances_are_only_counted():
    found = [Disturbance("van", f"p{k}", k, float(k + 1)) for k in range(10)]
    assert (
        join_disturbances(found)
        == "van " + ", then ".join(f"p{k}" for k in range(2, 10)) + ", and 2 smaller ones"
    )


def test_spans():
    assert format_span(19, 27, 0.1) == "for 0.9 s from t = 1.9 s"
    assert format_span(19, 19, 0.02) == "at t = 0.38 s"
    assert format_span(3, 7, None) == "for 5 steps from step 3"


def test_signals_of_vehicles_are_named_by_vehicle(drive_past, tape):
    columns, values = tabulate_signals(
        replay_tape(drive_past.problem("near"), tape).signals, drive_past.scene
    )
    assert "others_x[parked]" in columns
    assert values.shape == (9, len(columns))
    assert (values[:, columns.index("others_x[parked]")] == 40.0).all()
