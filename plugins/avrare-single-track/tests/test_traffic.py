"""Scripted vehicles: the recorded cars, constant velocity, and what comes after a plan's end."""

from pathlib import Path

import numpy as np
import pytest

from avrare.driving import Road
from avrare.scenario.load import load
from avrare_mpc.config import TrajectoryPlan
from avrare_single_track.config import VehicleConfig
from avrare_single_track.simulator import ScriptedTraffic

ROOT = Path(__file__).parents[3]
RECORDED = ROOT.parent / "shared" / "data" / "commonroad" / "complex_obstacles.csv"
ROAD = Road((-1.75, 1.75, 5.25), 3.5)
DT = 0.1
RECORDED_GOALS = {
    "cut_in": {"v_goal": 25.352},
    "merge": {
        "schedule": [{"from_step": 0, "to_step": 10, "lane": 0}, {"from_step": 13, "to_step": 79, "lane": 1}]
    },
}
SHORT = TrajectoryPlan(lanes=(1,), steps=6, v_goal=20.0)


def steps(n):
    return np.arange(n, dtype=np.int64)


def traffic(*vehicles):
    return ScriptedTraffic(tuple(VehicleConfig(**vehicle) for vehicle in vehicles), ROAD, DT)


@pytest.fixture(scope="module")
def scenario():
    return load(ROOT / "scenarios" / "lane_change_published.yaml")


@pytest.mark.parametrize(("name", "number"), [("parked", 14), ("cut_in", 13), ("merge", 15)])
def test_the_scenario_regenerates_the_recorded_cars(scenario, name, number):
    """Compare along the road, shifted, without what the scenario changes on purpose."""
    if not RECORDED.exists():
        pytest.skip("the recorded trajectories are not here")
    table = np.genfromtxt(RECORDED, delimiter=",", names=True)
    rows = table[table["id"] == number][: scenario.steps + 1]
    assert len(rows) == 40
    config = scenario.simulator.config
    [vehicle] = [vehicle for vehicle in config.vehicles if vehicle.name == name]
    if vehicle.drive is not None:
        drive = TrajectoryPlan.model_validate(vehicle.drive.model_dump() | RECORDED_GOALS[name])
        vehicle = vehicle.model_copy(update={"drive": drive})
    found = ScriptedTraffic((vehicle,), ROAD, config.dt).at(steps(len(rows)))
    shift = vehicle.x - rows["x"][0]
    np.testing.assert_allclose(found.x[:, 0] - shift, rows["x"], atol=1e-3)
    for ours, theirs in (("y", "y"), ("speed", "v"), ("heading", "heading")):
        np.testing.assert_allclose(getattr(found, ours)[:, 0], rows[theirs], atol=1e-3)
    # the record gives the acceleration that leads to the next sample, we the one that led to this one
    np.testing.assert_allclose(found.acceleration[2:, 0], rows["acc"][1:-1], atol=1e-2)


def test_constant_velocity_and_parked():
    moving = {"name": "a", "x": 1.0, "y": 2.0, "speed": 10.0, "heading": 0.1}
    found = traffic(moving, {"name": "b", "x": 5.0, "y": -1.0}).at(steps(50))
    time = DT * steps(50)
    np.testing.assert_allclose(found.x[:, 0], 1.0 + 10.0 * time * np.cos(0.1), atol=1e-12)
    np.testing.assert_allclose(found.y[:, 0], 2.0 + 10.0 * time * np.sin(0.1), atol=1e-12)
    for name, values in {"speed": [10.0, 0.0], "heading": [0.1, 0.0], "acceleration": [0.0, 0.0]}.items():
        assert (getattr(found, name) == values).all(), name
    assert (np.stack([found.x[:, 1], found.y[:, 1]], axis=1) == [5.0, -1.0]).all()


def test_constant_velocity_after_the_plan():
    fixed = {"name": "a", "x": 0.0, "y": 1.75, "speed": 3.0}
    found = traffic({"name": "b", "x": 0.0, "y": 1.75, "speed": 10.0, "drive": SHORT}, fixed).at(steps(20))
    speed, x = found.speed[:, 0], found.x[:, 0]
    assert (np.diff(speed[:6]) > 0.0).all()
    assert (speed[5:] == speed[5]).all()
    np.testing.assert_allclose(np.diff(x[5:]), speed[5] * DT * np.cos(found.heading[5, 0]), atol=1e-12)
    np.testing.assert_allclose(found.acceleration[1:6, 0], np.diff(speed[:6]) / DT, atol=1e-12)
    assert found.acceleration[0, 0] == 0.0
    assert (found.acceleration[6:] == 0.0).all()
    np.testing.assert_allclose(found.x[:, 1], 3.0 * DT * steps(20), atol=1e-12)


def test_plans_of_different_lengths_do_not_mix():
    longer = SHORT.model_copy(update={"steps": 15})
    one = {"name": "a", "x": 0.0, "y": 1.75, "speed": 10.0, "drive": SHORT}
    two = {"name": "b", "x": 30.0, "y": 1.75, "speed": 12.0, "drive": longer}
    both = traffic(one, two).at(steps(30))
    for v, vehicle in enumerate((one, two)):
        alone = traffic(vehicle).at(steps(30))
        for name in ("x", "y", "heading", "speed", "acceleration"):
            assert np.array_equal(getattr(both, name)[:, v], getattr(alone, name)[:, 0])
