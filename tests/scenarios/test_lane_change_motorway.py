"""The lane change on a motorway: what fails depends on the stack and the traffic, not on one number."""

from pathlib import Path

import numpy as np
import pytest

from avrare.rollout.loaded_scenario import LoadedScenario
from avrare.rollout.noise import NoiseSource
from avrare.rollout.request import Request
from avrare.scenario.load import load

SCENARIO = Path(__file__).parents[2] / "scenarios" / "lane_change_motorway.yaml"
RULES = ("safe_distance", "no_abrupt_braking", "traffic_flow", "left_traffic", "no_collision")


def problem_of(*settings):
    return LoadedScenario(load(str(SCENARIO), settings)).problem(RULES)


def simulate(problem, count):
    rows = np.arange(count)
    request = Request.from_start(np.zeros_like(rows), rows)
    return problem.simulate(NoiseSource(21, problem.noise_size), request, scored=False)


@pytest.fixture(scope="module")
def problem():
    return problem_of()


def test_the_noise_free_drive_keeps_every_rule_and_passes_on_the_left(problem):
    nominal = problem.nominal(keep_carries=True)
    assert not nominal.violated.any()
    assert (nominal.robustness > 0.1).all()
    assert nominal.counts["fallback_solves"].sum() == 0
    worlds = [carry.system.world for _, _, carry in nominal.carries]
    beside = [world.ego.y[0] for world in worlds if abs(world.ego.x[0] - world.others.x[0, 0]) < 4.0]
    assert len(beside) > 1
    assert min(beside) > 4.0


def test_it_begins_with_tracks_of_those_whom_the_sensor_sees(problem):
    loop = problem.system
    state = loop.initial(np.random.default_rng(0).standard_normal((300, loop.noise_size)))
    exists = loop.tracker.estimate(state.track).exists.mean(axis=0)
    assert 0.02 < exists[0] < 0.6  # 130 to 190 m ahead
    assert exists[1:].min() > 0.8


@pytest.mark.slow
def test_without_errors_of_perception_nobody_is_hit_and_nothing_brakes_abruptly():
    found = simulate(problem_of("perception=null"), 300)
    assert not found.error.any()
    assert found.violated.sum(axis=0)[[1, 4]].tolist() == [0, 0]


@pytest.mark.slow
def test_ten_metres_change_no_probability_by_a_factor_of_three(problem):
    counts = [
        simulate(each, 500).violated.sum(axis=0)
        for each in (problem, problem_of("simulator.ego.x=10"), problem_of("simulator.ego.x=-10"))
    ]
    often = counts[0] > 20  # of the others 500 drives say nothing
    assert often.sum() == 3
    for moved in counts[1:]:
        ratio = moved[often] / counts[0][often]
        assert (ratio > 1.0 / 3.0).all()
        assert (ratio < 3.0).all()
