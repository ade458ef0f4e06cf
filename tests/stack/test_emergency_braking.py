"""Emergency braking beside a controller."""

from pathlib import Path

import numpy as np
import pytest

from avrare.driving import Action, Prediction, Road, Scene, Vehicles
from avrare.protocols import Controller
from avrare.rollout.loaded_scenario import LoadedScenario
from avrare.scenario.load import load
from avrare.scenario.timing import Aeb
from avrare.stack.emergency_braking import EmergencyBraking

DT, LENGTH, WIDTH = 0.1, 4.0, 2.0
SCENARIO = Path(__file__).parents[2] / "scenarios" / "lane_change.yaml"


class Coasting(Controller):
    """Controller that does nothing, or accelerates and turns."""

    horizon = 5

    def __init__(self, acceleration=0.0):
        self.acceleration = acceleration

    def start(self, n):
        return np.zeros(n, dtype=np.int64)

    def act(self, memory, ego, prediction):
        n = len(ego.x)
        return Action(np.full(n, self.acceleration), np.full(n, 0.01)), memory + 1

    def counts(self, memory):
        return {"plans": memory}


def drive(options, speed, place, y=0.0, other_speed=0.0, heading=0.0, acceleration=0.0, steps=100):
    """Return gaps, speeds and accelerations (steps,) of an ego, and the last counts."""
    scene = Scene(DT, Road((0.0,), 4.0), LENGTH, WIDTH, ("car",), *map(np.array, ([LENGTH], [WIDTH], [True])))
    controller = EmergencyBraking(Coasting(acceleration), options, scene)
    memory, x, v, found = controller.start(1), 0.0, speed, []
    for step in range(steps):
        ego = Vehicles(*(np.array([part]) for part in (x, 0.0, heading, v, 0.0)))
        ahead = place + other_speed * DT * (step + np.arange(6.0))
        prediction = Prediction(ahead[None, None], np.full((1, 1, 6), float(y)))
        action, memory = controller.act(memory, ego, prediction)
        a = float(action.acceleration[0])
        found.append((ahead[0] - x - LENGTH, v, a))
        assert action.yaw_rate[0] == 0.01
        x, v = x + v * DT + 0.5 * a * DT**2, v + a * DT
    return (*np.array(found).T, controller.counts(memory))


def test_it_begins_where_more_braking_is_needed_after_a_delay_and_along_a_ramp():
    options = Aeb(needed_deceleration=5.0, delay=0.2, ramp=30.0, deceleration=8.0)
    gap, speed, acceleration, counts = drive(options, 20.0, 100.0)
    decided = np.flatnonzero(20.0**2 / (2.0 * gap) > 5.0)[0]
    np.testing.assert_allclose(acceleration[: decided + 2], 0.0)
    np.testing.assert_allclose(acceleration[decided + 2 : decided + 6], [-3.0, -6.0, -8.0, -8.0])
    assert gap.min() > 3.0
    assert speed[-1] == pytest.approx(0.0, abs=1e-9)
    assert counts["aeb_interventions"].tolist() == [1]
    assert counts["plans"].tolist() == [100]


def test_a_later_begin_hits_and_an_earlier_one_stops_farther_away():
    cases = ((3.0, 0.0), (5.0, 0.2), (7.9, 0.5))
    blocks = (Aeb(needed_deceleration=needed, delay=delay) for needed, delay in cases)
    nearest = [drive(block, 25.0, 150.0)[0].min() for block in blocks]
    assert nearest[0] > nearest[1] > 0.0 > nearest[2]


def test_it_may_begin_by_the_time_to_collision():
    options = Aeb(needed_deceleration=None, time_to_collision=1.5, delay=0.0)
    gap, _, acceleration, _ = drive(options, 20.0, 100.0)
    begin = np.flatnonzero(acceleration < 0.0)[0]
    assert gap[begin] < 30.0 <= gap[begin - 1]


@pytest.mark.parametrize(
    "case",
    [
        {"y": 2.3},  # passes beside it
        {"other_speed": 21.0},  # goes away
        {"heading": 0.1, "place": 80.0},  # the course leads past it
        {"place": -20.0},  # it is behind
        {"place": np.inf},  # it does not exist
    ],
)
def test_what_is_not_in_the_way_does_not_brake(case):
    given = {"place": 60.0, "steps": 20, **case}
    _, _, acceleration, counts = drive(Aeb(side_room=0.2), 20.0, acceleration=0.5, **given)
    np.testing.assert_allclose(acceleration, 0.5)
    assert counts["aeb_interventions"].tolist() == [0]


def test_it_ends_with_the_danger_and_counts_each_time():
    options = Aeb(delay=0.0)
    _, speed, acceleration, counts = drive(options, 25.0, 40.0, other_speed=10.0, acceleration=3.0, steps=200)
    assert counts["aeb_interventions"][0] > 1
    assert acceleration[-5:].max() == pytest.approx(3.0) or speed[-1] < 20.0
    assert (acceleration == 3.0).any()


def test_the_block_of_a_scenario_is_resolved_and_counted():
    scenario = load(str(SCENARIO), ["aeb={needed_deceleration: 4.0}", "steps=3"])
    assert scenario.resolved["aeb"]["needed_deceleration"] == 4.0
    assert "aeb" not in load(str(SCENARIO)).resolved
    nominal = LoadedScenario(scenario).problem(("no_collision",)).nominal()
    assert nominal.counts["aeb_interventions"].tolist() == [0]
    assert "fallback_solves" in nominal.counts
