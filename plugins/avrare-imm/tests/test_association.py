"""Association: the assignment against SciPy's, and what swapped and false detections do to tracks."""

from dataclasses import replace

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.optimize import linear_sum_assignment

from avrare.base.errors import UsageError
from avrare.driving import Observation
from avrare_imm.assignment import assign
from avrare_imm.config import ImmConfig
from avrare_imm.tracker import build
from tracked_cars import scene, world

OPTIONS = {"start": "truth", "association": "hungarian", "gate": 4.0, "death": 3}


def test_the_assignment_is_scipys():
    rng = np.random.default_rng(0)
    for _ in range(120):
        n, tracks, items = rng.integers(1, 5), rng.integers(1, 8), rng.integers(0, 8)
        gain = rng.normal(size=(n, tracks, items))
        gain[rng.uniform(size=gain.shape) < rng.uniform(0, 0.8)] = -np.inf
        chosen = assign(gain)
        for row, given in zip(gain, chosen, strict=True):
            nothing = np.zeros((tracks, tracks))
            cost = np.concatenate([np.where(row > 0, -row, 1e6), nothing], axis=1)
            best = -cost[linear_sum_assignment(cost)].sum()
            pairs = [(t, s) for t, s in enumerate(given.tolist()) if s >= 0]
            assert len({s for _, s in pairs}) == len(pairs)
            assert sum(row[pair] for pair in pairs) == pytest.approx(best)


def cars(places, speed=20.0):
    """Return a world with cars at (V, 2) places, in one particle."""
    x, y = np.asarray(places, float).T[:, None]
    return world(x, y, np.zeros_like(x), np.full_like(x, speed), np.zeros_like(x))


def seen(places, speed=20.0):
    """Return a list of detections at (S, 2) places; NaN: an empty slot."""
    x, y = np.asarray(places, float).reshape(-1, 2).T[:, None]
    return Observation(~np.isnan(x), x, y, np.where(np.isnan(x), np.nan, speed))


def follow(tracker, start, lists):
    track = tracker.start(start)
    for one in lists:
        track = tracker.update(track, one)
    return track


def ahead(t):
    return [[10 + 2.0 * t, 1.75], [30 + 2.0 * t, 5.25]]


def test_detections_in_any_order_give_the_same_tracks():
    tracker = build(ImmConfig(**OPTIONS), scene(2))
    lists = [np.array([*ahead(t), [80.0 + 2.0 * t, 1.75]]) for t in range(1, 9)]
    rng = np.random.default_rng(2)
    one = follow(tracker, cars(ahead(0)), [seen(part) for part in lists])
    other = follow(tracker, cars(ahead(0)), [seen(rng.permutation(part)) for part in lists])
    np.testing.assert_array_equal(tracker.predict(one, 3).x, tracker.predict(other, 3).x)
    assert tracker.estimate(one).exists[0].tolist() == [True, True, True, False, False, False]


def test_labels_are_believed_only_where_they_are_given():
    swapped = [seen(ahead(t)[::-1]) for t in range(1, 6)]
    told = build(ImmConfig(gate=None), scene(2))
    finding = build(ImmConfig(**OPTIONS), scene(2))
    pulled = told.predict(follow(told, cars(ahead(0)), swapped), 0).x[0, :, 0]
    found = finding.predict(follow(finding, cars(ahead(0)), swapped), 0).x[0, :2, 0]
    truth = np.array(ahead(5))[:, 0]
    assert (np.abs(pulled - truth) > 5.0).all()
    np.testing.assert_allclose(found, truth, atol=0.01)


def test_cars_side_by_side_can_be_swapped():
    # two cars cross within the gate of both: nearer is likelier, though wrong
    tracker = build(ImmConfig(**OPTIONS, velocity="none"), scene(2))
    start = cars([[10.0, 1.75], [11.0, 1.75]])
    wrong = seen([[13.0, 1.75], [12.0, 1.75]])  # the first went 3 m, the second 1 m
    x = tracker.predict(tracker.update(tracker.start(start), wrong), 0).x[0, :2, 0]
    assert x[0] == pytest.approx(12.0, abs=0.1)
    assert x[1] == pytest.approx(13.0, abs=0.1)


def test_a_ghost_gets_a_track_and_loses_it():
    tracker = build(ImmConfig(**OPTIONS, birth=(2, 3)), scene(1))
    empty, ghost = [np.nan, np.nan], [50.0, 1.75]
    lists = [seen([[10 + 2.0 * t, 1.75], ghost if t in (2, 3) else empty], 20.0) for t in range(1, 9)]
    for one in lists:  # a ghost stands still
        one.speed_x[:, 1] = np.where(one.detected[:, 1], 0.0, np.nan)
    track = tracker.start(cars([[10.0, 1.75]]))
    known = []
    for one in lists:
        track = tracker.update(track, one)
        known.append(int(tracker.estimate(track).exists[0, 1:].sum()))
    assert known == [0, 0, 1, 1, 1, 0, 0, 0]
    assert tracker.predict(track, 2).x.shape == (1, 5, 3)
    assert np.isposinf(tracker.predict(track, 2).x[0, 1:]).all()


def test_too_many_false_detections_do_not_disturb_the_tracks_there_are():
    tracker = build(ImmConfig(**OPTIONS, spare_tracks=1), scene(1))
    lists = [seen([[10 + 2.0 * t, 1.75], *([60.0 + 10 * k, 5.25] for k in range(4))]) for t in (1, 2, 3)]
    track = follow(tracker, cars([[10.0, 1.75]]), lists)
    assert tracker.predict(track, 0).x[0, 0, 0] == pytest.approx(16.0, abs=0.01)


def test_nothing_is_known_at_an_empty_start():
    tracker = build(ImmConfig(**OPTIONS | {"start": "empty"}), scene(2))
    track = tracker.start(cars(ahead(0)))
    assert not tracker.estimate(track).exists.any()
    for t in (1, 2):
        track = tracker.update(track, seen(ahead(t)))
    assert tracker.estimate(track).exists[0].tolist() == [True, True, False, False, False, False]


def test_a_detection_at_no_place_stays_an_error_and_no_other_is_given_twice():
    tracker = build(ImmConfig(**OPTIONS), scene(1))
    x, there = np.array([[12.0, np.nan]]), np.ones((1, 2))
    track = tracker.start(cars([[10.0, 1.75]]))
    found = tracker.estimate(tracker.update(track, Observation(there > 0, x, 1.75 * there, 20 * there)))
    assert found.x[0, 0] == pytest.approx(12.0, abs=0.01)
    assert np.isnan(found.x[0, 1])


def test_a_controller_is_told_of_the_spare_tracks():
    known = build(ImmConfig(**OPTIONS, spare_tracks=2), scene(2)).known_scene
    assert known.names[2:] == ("track 1", "track 2")
    assert len(known.lengths) == len(known.widths) == len(known.moving) == 4


def test_reported_headings_measure_the_speed_across():
    places = [[10.0 + 2.0 * t, 1.75 + 0.1 * t] for t in range(6)]
    found = {}
    for kind in ("none", "velocity", "heading"):
        tracker = build(ImmConfig(start="truth", lateral_speed=kind, lateral_speed_variance=0.01), scene(1))
        track = tracker.start(cars(places[:1]))
        for place in places[1:]:
            across, heading = np.full((1, 1), 1.0), np.full((1, 1), np.arctan(0.05) + np.pi)
            track = tracker.update(track, replace(seen([place]), speed_y=across, heading=heading))
        found[kind] = float(tracker.estimate(track).vy[0, 0])
    assert abs(found["velocity"] - 1.0) < abs(found["none"] - 1.0)
    assert found["heading"] == pytest.approx(found["velocity"], abs=0.05)  # half a turn makes no difference


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"association": "hungarian"}, "needs gate and death"),
        ({"association": "hungarian", "gate": 4}, "needs death"),
        ({"spare_tracks": 2}, "only association: hungarian has any"),
    ],
)
def test_options_that_do_not_fit_are_refused(options, message):
    with pytest.raises(ValidationError, match=message):
        ImmConfig(**options)


def test_what_perception_does_not_report_cannot_be_measured():
    tracker = build(ImmConfig(lateral_speed="heading"), scene(1))
    with pytest.raises(UsageError, match="lateral_speed: heading needs a perception that reports it"):
        tracker.update(tracker.start(cars([[10.0, 1.75]])), seen([[12.0, 1.75]]))
