"""The tracker as the closed loop uses it."""

import dataclasses
import subprocess
import sys

import numpy as np
import pytest
from pydantic import ValidationError

from avrare.driving import Observation, Road, Scene
from avrare.protocols import Tracker
from avrare_imm import avrare_components
from avrare_imm.config import ImmConfig
from avrare_imm.tracker import build
from tracked_cars import lane_change, noisy, scene, world


def test_start_knows_the_world_and_the_lane():
    zero = np.zeros((2, 3))
    y = np.array([[1.75, 5.25, 1.75 + 0.06], [-1.75, 3.5, 1.75 - 0.04]])
    tracker = build(ImmConfig(start="truth"), scene(3))
    track = tracker.start(world(zero + 7, y, zero + 0.1, zero + 20, zero - 2))
    now = tracker.estimate(track)
    np.testing.assert_allclose(now.x, 7)
    np.testing.assert_allclose(now.vx, 20 * np.cos(0.1))
    np.testing.assert_allclose(now.ax, -2)
    np.testing.assert_allclose(now.y, y)
    np.testing.assert_allclose(now.vy, 20 * np.sin(0.1))
    np.testing.assert_allclose(now.longitudinal_covariance, np.broadcast_to(np.eye(3), (2, 3, 3, 3)))
    matched, third = np.array([1, 9, 1]) / 11, np.full(3, 1 / 3)
    lanes = [[matched, matched[[0, 2, 1]], third], [matched[[1, 0, 2]], third, matched]]
    moves = 0.999
    np.testing.assert_allclose(now.lane_probabilities, moves * np.array(lanes))
    np.testing.assert_allclose(track.lateral.probability[0, 0], [*np.tile(moves * matched / 3, 3), 1 - moves])
    expected = np.broadcast_to([moves / 2, moves / 2, 1 - moves], (2, 3, 3))
    np.testing.assert_allclose(track.longitudinal.probability, expected)


def test_follows_a_lane_change_better_than_raw_measurements():
    rng = np.random.default_rng(9)
    n = 40
    x, y, vx = lane_change(n)
    zero = np.zeros((n, 1))
    tracker = build(ImmConfig(start="truth"), scene(1))
    track = tracker.start(world(x[0], y[0], zero, vx[0], zero + 2))
    errors, raw, lanes = [], [], []
    for k in range(1, len(x)):
        seen = noisy(rng, x[k], y[k], vx[k], missing=0.3)
        track = tracker.update(track, seen)
        now = tracker.estimate(track)
        errors.append([now.x - x[k], now.y - y[k], now.vx - vx[k]])
        raw.append([seen.x - x[k], seen.y - y[k], seen.speed_x - vx[k]])
        lanes.append(now.lane_probabilities[:, 0].mean(0))
    ours = np.sqrt(np.mean(np.square(errors), axis=(0, 2, 3)))
    theirs = np.sqrt(np.nanmean(np.square(raw), axis=(0, 2, 3)))
    assert (ours < [0.7, 0.8, 1.0] * theirs).all(), (ours, theirs)
    assert lanes[13].argmax() == 1  # before it sets off
    assert lanes[13][1] > 0.8
    assert lanes[-1].argmax() == 2
    assert lanes[-1][2] > 0.8


def test_prediction_starts_at_the_estimate_and_heads_for_the_lane():
    rng = np.random.default_rng(10)
    x, y, vx = lane_change(20)
    zero = np.zeros((20, 1))
    tracker = build(ImmConfig(start="truth"), scene(1))
    track = tracker.start(world(x[0], y[0], zero, vx[0], zero + 2))
    for k in range(1, 21):  # half a second into the lane change
        track = tracker.update(track, noisy(rng, x[k], y[k], vx[k]))
    now, ahead = tracker.estimate(track), tracker.predict(track, 20)
    assert ahead.x.shape == ahead.y.shape == (20, 1, 21)
    np.testing.assert_array_equal(ahead.x[..., 0], now.x)
    np.testing.assert_array_equal(ahead.y[..., 0], now.y)
    np.testing.assert_array_equal(tracker.predict(track, 5).y, ahead.y[..., :6])
    if_it_stayed = np.abs(now.y - y[40]).mean()
    assert np.abs(ahead.y[..., -1] - y[40]).mean() < 0.6 * if_it_stayed
    assert np.abs(ahead.x[..., -1] - x[40]).mean() < 2.5


def test_one_model_is_a_plain_kalman_filter():
    config = ImmConfig(start="truth", longitudinal_models=("ca",), derivative_gains=(4.0,))
    one_lane = Road((0.0,), 3.5)
    base = scene(1)
    tracker = build(config, Scene(**{**vars(base), "road": one_lane}))
    zero = np.zeros((2, 1))
    track = tracker.start(world(zero, zero, zero, zero + 10, zero))
    track = tracker.update(track, Observation(zero == 0, zero + 1, zero, zero + 10))
    np.testing.assert_array_equal(track.lateral.probability, 1.0)
    assert np.abs(tracker.estimate(track).x - 1).max() < 0.1


@pytest.mark.parametrize(
    "options",
    [
        {"stay_probability": 1.0},
        {"derivative_gains": ()},
        {"longitudinal_models": ("ctrv",)},
        {"position_variance": 0.0},
        {"lane_tolerance": float("inf")},
        {"gains": (3.0,)},
    ],
)
def test_wrong_options(options):
    with pytest.raises(ValidationError):
        ImmConfig(**options)


def test_component_resolves_and_imports_nothing_heavy():
    component, _ = avrare_components()
    assert (component.kind, component.name) == ("tracker", "imm")
    assert component.load_config() is ImmConfig
    tracker: Tracker = component.load_factory()(ImmConfig(), scene(2))
    assert callable(tracker.predict)
    code = (
        "import sys, avrare_imm, avrare_imm.config\n"
        "heavy = {'torch', 'pyro', 'casadi', 'numba', 'scipy', 'matplotlib', 'filterpy'} & set(sys.modules)\n"
        "sys.exit(f'imported {heavy}' if heavy else 0)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_without_lanes_a_crossing_car_is_followed_in_any_direction():
    plane = dataclasses.replace(scene(1), road=Road((), 4.0))
    tracker = build(ImmConfig(start="empty", velocity="none", gate=4.0, lateral_noise=1.0), plane)
    zero = np.zeros((20, 1))
    for heading in (0.0, 1.0, np.pi / 2, 2.5, -1.8):
        rng = np.random.default_rng(2)
        vx, vy = 9.0 * np.cos(heading), 9.0 * np.sin(heading)
        track = tracker.start(world(zero, zero, zero + heading, zero + 9.0, zero))
        for k in range(1, 31):
            place = np.array([vx, vy]) * plane.dt * k
            x, y = (part + rng.normal(0, 0.3, zero.shape) for part in place)
            track = tracker.update(track, Observation(zero == 0.0, x, y, zero))
        ahead = np.stack([tracker.predict(track, 20).x, tracker.predict(track, 20).y])
        assert np.abs(ahead[..., 0] - place[:, None, None]).mean(axis=(1, 2)).max() < 0.4
        moved = (ahead[..., 20] - ahead[..., 0]).mean(axis=(1, 2))
        np.testing.assert_allclose(moved / (20 * plane.dt), [vx, vy], atol=0.8)
