from pathlib import Path

import numpy as np
import pytest

from avrare.base.errors import UsageError
from avrare.driving import Road
from avrare_mpc.config import TrajectoryPlan
from avrare_mpc.trajectory import plan_trajectory

RECORDED = Path(__file__).parents[4] / "shared" / "data" / "commonroad" / "complex_obstacles.csv"


@pytest.mark.parametrize(("name", "number"), [("cut_in", 13), ("merging", 15)])
def test_recorded_cars_are_regenerated(lane_change, name, number):
    if not RECORDED.exists():
        pytest.skip("the recorded trajectories are not here")
    table = np.genfromtxt(RECORDED, delimiter=",", names=True)
    rows = table[table["id"] == number]
    found, n = getattr(lane_change, name), len(rows)
    assert n == 41
    for ours, theirs in (("x", "x"), ("y", "y"), ("speed", "v"), ("heading", "heading")):
        np.testing.assert_allclose(getattr(found, ours)[:n], rows[theirs], atol=2e-4)
    # the record's first acceleration is that of the initial state, not of the plan
    np.testing.assert_allclose(found.acceleration[1:n], rows["acc"][1:], atol=1e-3)


def test_trajectory_follows_the_model_and_its_bounds(lane_change):
    car, dt = lane_change.merging, lane_change.scene.dt
    np.testing.assert_allclose(np.diff(car.x), dt * (car.speed * np.cos(car.heading))[:-1], atol=1e-7)
    np.testing.assert_allclose(np.diff(car.y), dt * (car.speed * np.sin(car.heading))[:-1], atol=1e-7)
    np.testing.assert_allclose(np.diff(car.speed), dt * car.acceleration[:-1], atol=1e-7)
    assert np.abs(np.diff(car.heading)).max() <= dt * 0.4 + 1e-6
    assert len(car.x) == 80
    assert car.acceleration[-1] == 0.0


def test_unknown_lane_is_a_usage_error():
    with pytest.raises(UsageError, match="lane 2 does not exist"):
        plan_trajectory(TrajectoryPlan(), 0.0, 1.75, 10.0, 0.0, Road((-1.75, 1.75), 3.5), 0.1)


@pytest.mark.parametrize(
    "schedule",
    [
        [{"from_step": 3, "to_step": 2, "lane": 1}],
        [{"from_step": 0, "to_step": 80, "lane": 1}],
        [{"from_step": 0, "to_step": 5, "lane": 1}, {"from_step": 5, "to_step": 9, "lane": 2}],
    ],
)
def test_wrong_schedules_are_refused(schedule):
    with pytest.raises(ValueError, match=r"schedule|to_step"):
        TrajectoryPlan.model_validate({"schedule": schedule})
