"""Vehicles that stand, and tracks that have lost their vehicle."""

import numpy as np
import pytest

from avrare.driving import Observation
from avrare_imm.config import ImmConfig
from avrare_imm.tracker import build
from tracked_cars import scene, world

ASIDE = 2.6  # y of a car that stands 0.85 m beside the middle of its lane
MOVING_ONLY = ("cv", "ca")


def follow(config, x, y, seen, noise=0.2):
    """Return the tracker and the tracks of 50 cars at places x, y (steps + 1,), detected where ``seen``."""
    rng, n = np.random.default_rng(3), 50
    tracker = build(config, scene(1))
    nothing = np.zeros((n, 1))
    tracks = [tracker.start(world(*[nothing] * 5))]
    for t in range(1, len(x)):
        detected = np.full((n, 1), bool(seen[t]))
        places = (np.where(detected, at[t] + rng.normal(0, noise, (n, 1)), np.nan) for at in (x, y))
        tracks.append(tracker.update(tracks[-1], Observation(detected, *places, np.full((n, 1), np.nan))))
    return tracker, tracks


def drift(models):
    """Return by how much the mean track of a car that stands moves sideways in 1 s of misses."""
    config = ImmConfig(start="empty", velocity="none", longitudinal_models=models)
    seen = np.arange(41) <= 30
    tracker, tracks = follow(config, np.full(41, 40.0), np.full(41, ASIDE), seen)
    before, after = (tracker.estimate(tracks[t]).y.mean() for t in (30, 40))
    return after - before


def test_a_car_that_stands_does_not_drift_sideways():
    assert abs(drift(("cv", "ca", "stand"))) < 0.05
    assert drift(MOVING_ONLY) < -0.2


def test_a_car_that_stands_is_predicted_where_it_is():
    config = ImmConfig(start="empty", velocity="none")
    tracker, tracks = follow(config, np.full(31, 40.0), np.full(31, ASIDE), np.ones(31))
    ahead = tracker.predict(tracks[-1], 20)
    np.testing.assert_allclose(ahead.x.mean(axis=0)[0], 40.0, atol=0.2)
    np.testing.assert_allclose(ahead.y.mean(axis=0)[0], ASIDE, atol=0.1)


@pytest.mark.parametrize("speed", [3.0, 20.0])
def test_a_car_that_is_missed_keeps_its_speed(speed):
    time = 0.1 * np.arange(41)
    config = ImmConfig(start="empty", velocity="none")
    tracker, tracks = follow(config, speed * time, np.full(41, 1.75), time <= 3.0)
    before, after = (tracker.estimate(tracks[t]).vx.mean() for t in (30, 40))
    assert after == pytest.approx(before, rel=0.03)


def test_a_car_that_sets_off_is_followed():
    time = 0.1 * np.arange(61)
    x = 40.0 + np.maximum(time - 3.0, 0.0) ** 2  # 2 m/s^2 from 3 s on
    config = ImmConfig(start="empty", velocity="none")
    tracker, tracks = follow(config, x, np.full(61, 1.75), np.ones(61))
    now = tracker.estimate(tracks[-1])
    assert now.x.mean() == pytest.approx(x[-1], abs=0.2)
    assert now.vx.mean() == pytest.approx(6.0, abs=0.5)


def lost(restart):
    """Return how far the tracks are off, 0.1 to 0.5 s after their car is suddenly 6 m farther ahead."""
    time = 0.1 * np.arange(26)
    x = 20.0 * time + np.where(time > 2.0, 6.0, 0.0)
    config = ImmConfig(start="empty", velocity="none", gate=4.0, death=20, restart=restart)
    tracker, tracks = follow(config, x, np.full(26, 1.75), np.ones(26))
    found = [tracker.estimate(tracks[t]) for t in range(21, 26)]
    assert all(now.exists.all() for now in found)
    return [np.abs(now.x - at).mean() for now, at in zip(found, x[21:], strict=True)], found[-1]


def test_a_track_that_has_lost_its_car_begins_anew():
    off, now = lost(restart=3)
    assert min(off[:2]) > 2.0
    assert max(off[2:]) < 0.6
    assert now.vx.mean() == pytest.approx(20.0, abs=2.5)
    assert min(lost(restart=None)[0]) > 2.0


def test_a_detection_within_the_gate_keeps_a_track_from_beginning_anew():
    time = 0.1 * np.arange(31)
    off = np.where(np.isin(np.arange(31), (21, 22, 24, 25)), 6.0, 0.0)
    config = ImmConfig(start="empty", velocity="none", gate=4.0, death=20)
    tracker, tracks = follow(config, 20.0 * time + off, np.full(31, 1.75), np.ones(31))
    for t in range(20, 26):
        assert np.abs(tracker.estimate(tracks[t]).x - 20.0 * time[t]).max() < 2.0
