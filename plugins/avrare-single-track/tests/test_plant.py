"""The ego's motion: geometry of the single track, limits, accuracy."""

import numpy as np
import pytest

from avrare.driving import Action, Vehicles
from avrare_single_track.config import EgoConfig
from avrare_single_track.plant import advance

DT = 0.1
CAR = EgoConfig(x=0.0, y=0.0, speed=20.0)


def ego(n=1, x=0.0, y=0.0, heading=0.0, speed=20.0):
    return Vehicles(*(np.broadcast_to(np.asarray(value, float), n) for value in (x, y, heading, speed, 0.0)))


def action(acceleration=0.0, yaw_rate=0.0, n=1):
    return Action(*(np.broadcast_to(np.asarray(value, float), n) for value in (acceleration, yaw_rate)))


def drive(start, steering, what, steps, dt=DT, config=CAR):
    """Return all states and steering angles of repeating one action."""
    states, angles = [start], [steering]
    for _ in range(steps):
        state, angle, _ = advance(config, dt, states[-1], angles[-1], what)
        states.append(state)
        angles.append(angle)
    return states, np.array(angles)


def series(states, name):
    return np.array([getattr(state, name) for state in states])


@pytest.mark.parametrize(("speed", "yaw_rate"), [(20.0, 0.3), (20.0, -0.3), (5.0, 1.0), (40.0, 0.05)])
def test_steady_state_is_the_requested_circle(speed, yaw_rate):
    states, angles = drive(ego(speed=speed), np.zeros(1), action(0.0, yaw_rate), 60)
    steady = slice(30, None)
    angle = angles[-1, 0]
    np.testing.assert_allclose(angles[steady], angle, atol=1e-15)
    np.testing.assert_allclose(np.diff(series(states, "heading")[steady], axis=0), yaw_rate * DT, atol=1e-12)
    # the rear axle's circle is L / tan(steering); the centre is half a wheelbase ahead of it
    radius = np.hypot(CAR.wheelbase / np.tan(angle), 0.5 * CAR.wheelbase)
    assert radius == pytest.approx(speed / abs(yaw_rate), rel=1e-12)
    x, y = series(states, "x")[steady, 0], series(states, "y")[steady, 0]
    course = series(states, "heading")[steady, 0] + np.arctan(0.5 * np.tan(angle))
    side = np.sign(yaw_rate) * radius
    centre_x, centre_y = x - side * np.sin(course), y + side * np.cos(course)
    np.testing.assert_allclose(centre_x, centre_x[0], atol=1e-3)
    np.testing.assert_allclose(centre_y, centre_y[0], atol=1e-3)


def test_radius_at_a_steering_angle():
    # CommonRoad's mid-size car at 0.2 rad: 2.391 / tan(0.2) = 11.80 m about the rear axle
    steering = np.full(1, 0.2)
    yaw_rate = 5.0 * np.cos(np.arctan(0.5 * np.tan(0.2))) * np.tan(0.2) / 2.391
    states, angles = drive(ego(speed=5.0), steering, action(0.0, yaw_rate), 20)
    np.testing.assert_allclose(angles, 0.2, atol=1e-14)
    turned = series(states, "heading")[-1, 0]
    chord = np.hypot(series(states, "x")[-1, 0], series(states, "y")[-1, 0])
    radius = np.hypot(2.391 / np.tan(0.2), 0.5 * 2.391)
    assert chord == pytest.approx(2.0 * radius * np.sin(0.5 * turned), abs=1e-6)


def test_steering_rate_and_angle_are_limited():
    states, angles = drive(ego(speed=2.0), np.zeros(1), action(0.0, 50.0), 40)
    change = np.diff(angles[:, 0])
    np.testing.assert_allclose(change[:22], CAR.steering_rate_max * DT, atol=1e-12)
    assert angles.max() == angles[-1, 0] == CAR.steering_max
    assert np.isfinite(series(states, "heading")).all()
    _, back = drive(states[-1], angles[-1], action(0.0, -50.0), 60)
    assert np.abs(np.diff(back[:, 0])).max() <= CAR.steering_rate_max * DT + 1e-12
    assert back.min() == -CAR.steering_max


def test_limits_hold_for_random_actions():
    rng = np.random.default_rng(1)
    n, state, angle = 200, ego(200, speed=rng.uniform(0.0, CAR.speed_max, 200)), np.zeros(200)
    for _ in range(40):
        before, angle_before = state, angle
        asked = Action(rng.normal(0.0, 30.0, n), rng.normal(0.0, 2.0, n))
        state, angle, _ = advance(CAR, DT, state, angle, asked)
        assert (np.abs(state.acceleration) <= CAR.acceleration_max + 1e-9).all()
        assert ((state.speed >= 0.0) & (state.speed <= CAR.speed_max)).all()
        assert (np.abs(angle) <= CAR.steering_max).all()
        assert (np.abs(angle - angle_before) <= CAR.steering_rate_max * DT + 1e-12).all()
        assert np.array_equal(state.acceleration, (state.speed - before.speed) / DT)
        inside = (np.abs(asked.acceleration) <= CAR.acceleration_max) & (state.speed > 0.0)
        inside &= state.speed < CAR.speed_max
        np.testing.assert_allclose(state.acceleration[inside], asked.acceleration[inside], atol=1e-9)


def test_braking_ends_at_standstill_and_never_reverses():
    states, _ = drive(ego(speed=3.0), np.zeros(1), action(-8.0), 20)
    speed, x = series(states, "speed")[:, 0], series(states, "x")[:, 0]
    np.testing.assert_allclose(speed[:4], [3.0, 2.2, 1.4, 0.6], atol=1e-12)
    assert (speed[4:] == 0.0).all()
    assert states[4].acceleration[0] == pytest.approx(-6.0)  # what it took, not the 8 that were asked for
    assert (series(states, "acceleration")[5:] == 0.0).all()
    assert (np.diff(x) >= 0.0).all()
    assert x[-1] == x[4]


def test_a_standing_car_steers_but_does_not_turn():
    states, angles = drive(ego(speed=0.0), np.zeros(1), action(0.0, 0.3), 10)
    assert angles[-1, 0] > 0.3
    assert (series(states, "heading") == 0.0).all()


def turn(parts):
    """Return state after 0.4 s at full steering rate and 3 m/s^2, in steps of 0.4 s / parts."""
    states, _ = drive(ego(speed=10.0), np.zeros(1), action(3.0, 50.0), parts, dt=0.4 / parts)
    return np.array([getattr(states[-1], name)[0] for name in ("x", "y", "heading", "speed")])


def test_one_step_is_nearly_as_accurate_as_many_and_of_sixth_order():
    exact = turn(4000)
    error = {parts: np.abs(turn(parts) - exact).max() for parts in (1, 2, 4)}
    assert error[4] < 1e-9  # m, rad, m/s; the step of 0.1 s that scenarios use
    assert error[1] / error[2] > 60.0
    assert error[2] / error[4] > 60.0
