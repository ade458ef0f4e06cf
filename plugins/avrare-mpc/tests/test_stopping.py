"""A road that cannot be passed: the ego stops, whatever its plan costs."""

import numpy as np
import pytest

from avrare.rollout.loaded_scenario import LoadedScenario
from avrare.scenario.load import load

SCENE = """\
name: blocked
steps: {steps}
simulator:
  plugin: single_track
  dt: 0.1
  road: {{lane_centres: [-1.75, 1.75, 5.25], lane_width: 3.5, begin: -20.0, end: 400.0}}
  ego: {{x: 0.0, y: 1.75, speed: {speed}, friction: 1.0}}
  vehicles:
    - {{name: right, x: {x}, y: 1.75}}
    - {{name: left, x: {left}, y: 5.25}}
tracker: {{plugin: imm, velocity: none}}
controller:
  plugin: mpc
  backend: {backend}
  stops: {stops}
  lanes: [1, 2]
  lateral_acceleration_max: 4.0
  acceleration_max: 6.0
  turn_rate_weight: 2000.0
  turn_rate_change_weight: 150000.0
  smooth_start: true
specifications:
  no_collision: {{stl: always (gap > 0)}}
"""
LENGTH = 4.5
BACKENDS = [pytest.param("casadi", marks=pytest.mark.slow), "riccati"]


def drive(tmp_path, backend, x, speed, steps, left=None, stops="true"):
    """Return the speeds and the gaps of a drive up to cars at ``x``, seen perfectly."""
    path = tmp_path / "scene.yaml"
    numbers = {"x": x, "left": x if left is None else left, "speed": speed, "steps": steps, "stops": stops}
    path.write_text(SCENE.format(backend=backend, **numbers), encoding="utf-8")
    problem = LoadedScenario(load(str(path))).problem(("no_collision",))
    nominal = problem.nominal(keep_carries=True)
    assert not nominal.error.any()
    states = [carry.system for _, _, carry in nominal.carries]
    signals = [problem.system.signals(state) for state in states]
    return np.array([(float(s["ego_speed"][0]), float(s["gap"][0])) for s in signals]).T


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize(
    ("speed", "gap"), [(21.0, 60.0), (21.0, 150.0), (26.7, 60.0), (31.0, 80.6), (31.0, 150.0)]
)
def test_it_stops_before_a_blocked_road_where_6_metres_per_second_squared_can(tmp_path, backend, speed, gap):
    assert speed**2 / 12.0 < gap
    speeds, gaps = drive(tmp_path, backend, gap + LENGTH, speed, 130)
    assert gaps.min() > 0.0
    assert speeds[-1] < 0.1
    assert np.diff(speeds).min() > -0.61


@pytest.mark.parametrize("backend", BACKENDS)
def test_what_cannot_be_avoided_is_hit_as_slowly_as_it_can_be(tmp_path, backend):
    speeds, gaps = drive(tmp_path, backend, 45.0 + LENGTH, 31.0, 60)
    at_impact = speeds[np.flatnonzero(gaps <= 0.0)[0]]
    assert at_impact == pytest.approx(np.sqrt(31.0**2 - 12.0 * 45.0), abs=1.0)


def test_a_price_alone_is_cheaper_than_braking(tmp_path):
    speeds, gaps = drive(tmp_path, "riccati", 60.0 + LENGTH, 21.0, 60, stops="false")
    assert gaps.min() < 0.0
    assert speeds[np.flatnonzero(gaps < 0.0)[0]] > 18.0


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_car_that_can_be_passed_does_not_stop_it(tmp_path, backend):
    speeds, gaps = drive(tmp_path, backend, 68.0, 21.4, 60, left=400.0)
    assert gaps.min() > 0.3
    assert speeds.min() > 20.0
