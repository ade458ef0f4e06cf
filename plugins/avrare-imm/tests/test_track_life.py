"""Gate, birth, death and loss of tracks, vehicles that stand, and tracks without measured speeds."""

import numpy as np
import pytest
from pydantic import ValidationError

from avrare.base.batch import take
from avrare.driving import Observation
from avrare_imm.config import ImmConfig
from avrare_imm.imm import innovation_distance, mix, predict
from avrare_imm.life import LifeRules
from avrare_imm.tracker import build
from tracked_cars import lane_change, noisy, scene, world


def truth(n, v=1, speed=20.0):
    zero = np.zeros((n, v))
    return world(zero + 7, zero + 1.75, zero, zero + speed, zero)


def run(config, seen, x, y, speed):
    """Track one car at (steps + 1) places x, y, detected where ``seen`` (N, steps) says so."""
    tracker = build(config, scene(1))
    n = len(seen)
    tracks = [tracker.start(truth(n, speed=speed))]
    for t in range(1, len(x)):
        detected = seen[:, t - 1, None]
        fields = (np.where(detected, value, np.nan) for value in (x[t], y[t], speed))
        tracks.append(tracker.update(tracks[-1], Observation(detected, *fields)))
    return tracker, tracks


def exists(pattern, speed=20.0, **options):
    """Tell at which steps a car has a track; ``pattern`` has 1 for a detection, from step 1 on."""
    seen = np.array([[mark == "1" for mark in pattern]])
    x = 7 + 0.1 * speed * np.arange(len(pattern) + 1)
    _, tracks = run(ImmConfig(**options), seen, x, np.full(len(x), 1.75), speed)
    return "".join(str(int(track.life.exists[0, 0])) for track in tracks)


@pytest.mark.parametrize(
    ("pattern", "birth", "death", "expected"),
    [
        ("1111", (2, 3), None, "00111"),
        ("1011", (2, 3), None, "00011"),
        ("10011", (2, 3), None, "000001"),  # the first of them is too long ago
        ("1001", (2, 4), None, "00001"),
        ("1111", (1, 1), None, "01111"),
        ("0001", (1, 3), None, "00001"),
        ("111000", (2, 3), None, "0011111"),
        ("1110001100", (2, 3), 2, "00111000110"),
        ("110101", (2, 3), 2, "0011111"),
        ("11000", (2, 5), 3, "001110"),
        ("1100011", (2, 5), 3, "00111001"),  # the detections of the old track do not count for the new one
    ],
)
def test_birth_and_death(pattern, birth, death, expected):
    assert exists(pattern, start="empty", birth=birth, death=death) == expected


@pytest.mark.parametrize(("pattern", "expected"), [("0000", "11100"), ("00100011", "111111001")])
def test_a_track_that_starts_from_the_truth_may_end(pattern, expected):
    assert exists(pattern, start="truth", birth=(2, 3), death=3) == expected


def test_a_vehicle_without_a_track_is_infinitely_far_away():
    seen = np.array([[True, True, True], [False, False, True]])
    tracker, tracks = run(ImmConfig(start="empty"), seen, 7 + 2.0 * np.arange(4), np.full(4, 1.75), 20.0)
    for t, track in enumerate(tracks):
        ahead = tracker.predict(track, 5)
        known = np.array([t >= 2, False])
        assert np.array_equal(tracker.estimate(track).exists[:, 0], known)
        assert np.isposinf(ahead.x[~known]).all()
        assert np.isposinf(ahead.y[~known]).all()
        assert np.isfinite(ahead.x[known]).all()


@pytest.mark.parametrize(("velocity", "speed_sd"), [("noisy", 0.25), ("none", 2.0)])
def test_a_born_track_finds_position_and_speed(velocity, speed_sd):
    rng = np.random.default_rng(1)
    x, y, speed = lane_change(200, 20)
    tracker = build(ImmConfig(start="empty", velocity=velocity), scene(1))
    track = tracker.start(truth(200))
    for t in range(1, len(x)):
        seen = noisy(rng, x[t], y[t], speed[t])
        if velocity == "none":
            seen.speed_x[:] = np.nan  # not read
        track = tracker.update(track, seen)
    now = tracker.estimate(track)
    assert np.std(now.x - x[-1]) < 0.3
    assert np.std(now.vx - speed[-1]) < speed_sd


def test_two_detections_give_the_speed_of_their_difference():
    # with a wide prior, the second position determines the speed: (x2 - x1) / dt
    x, y = np.array([7.0, 10.0, 11.7]), np.full(3, 1.75)
    config = ImmConfig(start="empty", velocity="none", birth_speed_sd=1e4, longitudinal_models=("cv",))
    tracker, tracks = run(config, np.ones((1, 2), bool), x, y, 20.0)
    assert tracker.estimate(tracks[-1]).vx[0, 0] == pytest.approx(17.0, abs=0.01)


def outlier(config, size, misses=0):
    """Track a car at 20 m/s whose sixth detection, after ``misses`` missed ones, is ``size`` m off."""
    x, steps = 7 + 2.0 * np.arange(8 + misses), 5 + misses
    x[steps + 1 :] += size
    seen = np.ones((1, len(x) - 1), bool)
    seen[:, 5:steps] = False
    tracker, tracks = run(config, seen, x, np.full(len(x), 1.75), 20.0)
    return tracker.estimate(tracks[steps + 1]).x[0, 0] - (x[steps + 1] - size)


def test_the_gate_turns_an_outlier_into_a_miss():
    assert outlier(ImmConfig(), 4.0) > 0.5
    assert abs(outlier(ImmConfig(gate=4.0), 4.0)) < 0.05
    assert outlier(ImmConfig(gate=4.0), 0.6) == outlier(ImmConfig(), 0.6) > 0.1


def test_the_gate_widens_while_a_vehicle_is_missed():
    assert abs(outlier(ImmConfig(gate=4.0), 2.5)) < 0.05
    assert outlier(ImmConfig(gate=4.0), 2.5, misses=20) > 1.0


def test_the_gate_reads_the_measured_speed_too():
    seen, x = np.ones((1, 3), bool), 7 + 2.0 * np.arange(4)
    for velocity, expected in (("noisy", 0), ("none", 1)):
        config = ImmConfig(start="truth", gate=4.0, death=1, velocity=velocity)
        tracker = build(config, scene(1))
        track = tracker.start(truth(1))
        report = Observation(seen[:, :1], x[None, 1:2], np.full((1, 1), 1.75), np.full((1, 1), 30.0))
        assert tracker.update(track, report).life.exists[0, 0] == expected


def test_innovation_distance_of_one_mode_is_the_textbook_one():
    tracker = build(ImmConfig(longitudinal_models=("ca",)), scene(1))
    models = tracker.longitudinal
    track = tracker.start(truth(1)).longitudinal
    predicted = predict(models, mix(models, track))
    z = np.array([[[12.0, 18.0]]])
    residual = z[0, 0] - predicted.mean[0, 0, 0, :2]
    covariance = predicted.covariance[0, 0, 0, :2, :2] + np.diag(models.measurement_variance)
    expected = residual @ np.linalg.inv(covariance) @ residual
    assert innovation_distance(models, predicted, z)[0, 0] == pytest.approx(expected, rel=1e-12)


def test_innovation_distance_counts_the_spread_of_the_modes():
    # samples of the predicted mixture have a mean squared distance of p
    tracker, rng = build(ImmConfig(), scene(1)), np.random.default_rng(2)
    models, track = tracker.lateral, tracker.start(truth(1)).lateral
    for _ in range(3):
        track = predict(models, mix(models, track))
    count = 20_000
    mode = rng.choice(models.offset.shape[0], count, p=track.probability[0, 0] / track.probability.sum())
    sd = np.sqrt(track.covariance[0, 0, mode, 0, 0] + models.measurement_variance[0])
    z = track.mean[0, 0, mode, 0] + sd * rng.standard_normal(count)
    many = take(track, np.zeros(count, int))
    distance = innovation_distance(models, many, z[:, None, None])
    assert distance.mean() == pytest.approx(1.0, abs=0.04)


def test_a_gate_does_not_hide_a_nan():
    tracker = build(ImmConfig(start="truth", gate=3.0), scene(1))
    broken = Observation(np.ones((1, 1), bool), *[np.full((1, 1), np.nan)] * 3)
    after = tracker.update(tracker.start(truth(1)), broken)
    assert np.isnan(tracker.predict(after, 2).x).all()


def test_bits_of_life_reach_sixty_steps():
    rules = LifeRules(1, 60, 60)
    life, missed = rules.all((1, 1)), np.zeros((1, 1), bool)
    for _ in range(59):
        life = rules.update(life, missed, missed)
    assert life.exists.all()
    assert not rules.update(life, missed, missed).exists.any()


@pytest.mark.parametrize(
    "options", [{"birth": (3, 2)}, {"birth": (0, 2)}, {"death": 61}, {"gate": 0.0}, {"start": "late"}]
)
def test_wrong_options(options):
    with pytest.raises(ValidationError):
        ImmConfig(**options)


ASIDE = 2.6  # y of a car that stands 0.85 m beside the middle of its lane


def follow_cars(config, x, y, seen, noise=0.2):
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
    tracker, tracks = follow_cars(config, np.full(41, 40.0), np.full(41, ASIDE), seen)
    before, after = (tracker.estimate(tracks[t]).y.mean() for t in (30, 40))
    return after - before


def test_a_car_that_stands_does_not_drift_sideways():
    assert abs(drift(("cv", "ca", "stand"))) < 0.05
    assert drift(("cv", "ca")) < -0.2


def test_a_car_that_stands_is_predicted_where_it_is():
    config = ImmConfig(start="empty", velocity="none")
    tracker, tracks = follow_cars(config, np.full(31, 40.0), np.full(31, ASIDE), np.ones(31))
    ahead = tracker.predict(tracks[-1], 20)
    np.testing.assert_allclose(ahead.x.mean(axis=0)[0], 40.0, atol=0.2)
    np.testing.assert_allclose(ahead.y.mean(axis=0)[0], ASIDE, atol=0.1)


@pytest.mark.parametrize("speed", [3.0, 20.0])
def test_a_car_that_is_missed_keeps_its_speed(speed):
    time = 0.1 * np.arange(41)
    config = ImmConfig(start="empty", velocity="none")
    tracker, tracks = follow_cars(config, speed * time, np.full(41, 1.75), time <= 3.0)
    before, after = (tracker.estimate(tracks[t]).vx.mean() for t in (30, 40))
    assert after == pytest.approx(before, rel=0.03)


def test_a_car_that_sets_off_is_followed():
    time = 0.1 * np.arange(61)
    x = 40.0 + np.maximum(time - 3.0, 0.0) ** 2  # 2 m/s^2 from 3 s on
    config = ImmConfig(start="empty", velocity="none")
    tracker, tracks = follow_cars(config, x, np.full(61, 1.75), np.ones(61))
    now = tracker.estimate(tracks[-1])
    assert now.x.mean() == pytest.approx(x[-1], abs=0.2)
    assert now.vx.mean() == pytest.approx(6.0, abs=0.5)


def lost(restart):
    """Return how far the tracks are off, 0.1 to 0.5 s after their car is suddenly 6 m farther ahead."""
    time = 0.1 * np.arange(26)
    x = 20.0 * time + np.where(time > 2.0, 6.0, 0.0)
    config = ImmConfig(start="empty", velocity="none", gate=4.0, death=20, restart=restart)
    tracker, tracks = follow_cars(config, x, np.full(26, 1.75), np.ones(26))
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
    tracker, tracks = follow_cars(config, 20.0 * time + off, np.full(31, 1.75), np.ones(31))
    for t in range(20, 26):
        assert np.abs(tracker.estimate(tracks[t]).x - 20.0 * time[t]).max() < 2.0
