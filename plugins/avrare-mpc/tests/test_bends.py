"""Planning on bent roads: lengths along the ego's offset, and the turn rate of the road itself."""

import numpy as np
import pytest

from avrare.driving import Prediction, Road, Scene, Vehicles
from avrare.driving.reference_line import CurvedLine, Piece
from avrare_mpc.bends import measure_along_ego_offset, road_slip_angle, road_yaw_rate
from avrare_mpc.config import MpcConfig
from avrare_mpc.controller import MpcController

ARC = CurvedLine((Piece(400.0, 0.005, 0.005),))


def ego(y=2.0, x=50.0, n=1):
    return Vehicles(*(np.full(n, value) for value in (x, y, 0.0, 20.0, 0.0)))


def test_lengths_are_those_of_the_offset_curve():
    x = np.array([[[50.0, 90.0, 30.0]]])
    expected = [50.0, 50.0 + 40.0 * 0.99, 50.0 - 20.0 * 0.99]
    np.testing.assert_allclose(measure_along_ego_offset(ARC, ego(), x)[0, 0], expected)
    forth = ARC.advance(np.array([50.0]), np.array([2.0]), np.array([40.0 * 0.99]))
    assert forth[0] == pytest.approx(90.0)


def test_the_road_turns_the_ego():
    assert road_yaw_rate(ARC, ego(), 0.1)[0] == pytest.approx(20.0 * 0.005 / 0.99)
    assert road_yaw_rate(CurvedLine((Piece(400.0),)), ego(), 0.1)[0] == 0.0


@pytest.mark.parametrize("backend", ["riccati", "casadi"])
def test_a_plan_on_a_bend_is_that_of_the_straight_road_and_its_turn(backend):
    actions = []
    for line in (None, ARC):
        road = Road((-1.75, 1.75, 5.25), 3.5, line=line)
        scene = Scene(0.1, road, 4.3, 1.7, ("a",), np.array([4.3]), np.array([1.7]), np.ones(1, bool))
        controller = MpcController(MpcConfig(horizon=8, backend=backend), scene)
        along = 80.0 + 1.5 * np.arange(9)
        if line is not None:  # the same way, in stations
            along = ARC.advance(np.full(9, 50.0), np.full(9, 2.0), along - 50.0)
        prediction = Prediction(along[None, None], np.full((1, 1, 9), 1.75))
        action, memory = controller.act(controller.start(1), ego(), prediction)
        assert not memory.fallbacks.any()
        actions.append(action)
    straight, bent = actions
    assert bent.acceleration[0] == pytest.approx(straight.acceleration[0], abs=1e-5)
    assert bent.yaw_rate[0] == pytest.approx(straight.yaw_rate[0] + 20.0 * 0.005 / 0.99, abs=1e-5)


def test_the_slip_is_that_of_a_circle_about_the_road_s_centre():
    # the rear axle drives on a radius of sqrt(r^2 - (L / 2)^2), r that of the middle
    middle = (1.0 - 0.005 * ego().y[0]) / 0.005
    rear = np.sqrt(middle**2 - 1.35**2)
    assert road_slip_angle(ARC, ego(), 2.7)[0] == pytest.approx(np.arctan2(1.35, rear), rel=1e-12)
    assert road_slip_angle(CurvedLine((Piece(400.0),)), ego(), 2.7)[0] == 0.0


@pytest.mark.parametrize("limit", [4.0, 1.5])
def test_the_lateral_bound_counts_the_road_s_own_turn(limit):
    road = Road((-1.75, 1.75, 5.25), 3.5, line=ARC)
    none = np.zeros(0)
    scene = Scene(0.1, road, 4.3, 1.7, (), none, none, none.astype(bool))
    options = {"horizon": 8, "backend": "casadi", "y_goal": 5.25, "lanes": (2,), "turn_rate_weight": 0.0}
    prediction = Prediction(np.zeros((1, 0, 9)), np.zeros((1, 0, 9)))
    found = []
    for bound in (None, limit):
        controller = MpcController(MpcConfig(**options, lateral_acceleration_max=bound), scene)
        action, _ = controller.act(controller.start(1), ego(), prediction)
        found.append(20.0 * action.yaw_rate[0])
    own = 20.0 * road_yaw_rate(ARC, ego(), 0.1)[0]  # 2.02 m/s^2
    assert found[0] > 5.0
    assert found[1] == pytest.approx(max(limit, own))
