"""The lane change: plausible without noise; what fails is of stack and traffic, not of one number."""

import sys
from pathlib import Path

import numpy as np
import pytest

from avrare.rollout.loaded_scenario import LoadedScenario
from avrare.rollout.noise import NoiseSource
from avrare.scenario.load import load
from rollout_requests import fresh

ROOT = Path(__file__).parents[2]
SCENARIO = ROOT / "scenarios" / "lane_change.yaml"
sys.path.insert(0, str(ROOT / "benchmarks"))

from lane_change_levels import drive, drive_many  # noqa: E402

RULES = ("safe_distance", "no_abrupt_braking", "traffic_flow", "left_traffic", "no_collision")


def problem_of(*settings):
    return LoadedScenario(load(SCENARIO, settings)).problem(RULES)


def simulate(problem, count):
    return problem.simulate(NoiseSource(21, problem.noise_size), fresh(count), scored=False)


@pytest.fixture(scope="module")
def problem():
    return problem_of()


@pytest.fixture(scope="module")
def nominal(problem):
    return problem.nominal(keep_carries=True)


def test_it_names_neither_backend_nor_chunk_and_gets_the_defaults():
    scenario = load(SCENARIO)
    controller = scenario.controller.config
    assert {"backend", "search", "stops"}.isdisjoint(controller.model_fields_set)
    assert (controller.search, controller.stops, scenario.chunk) == ("everywhere", True, None)
    assert (scenario.tracker.config.start, scenario.simulator.config.after_impact) == ("burn_in", "end")


def test_the_noise_free_drive_keeps_every_rule_and_is_at_no_edge(nominal):
    assert not nominal.violated.any()
    assert (nominal.robustness > 0.1).all()
    assert nominal.counts["fallback_solves"].sum() == nominal.counts["friction_saturations"].sum() == 0


def test_the_noise_free_drive_passes_on_the_left_and_returns(nominal):
    worlds = [carry.system.world for _, _, carry in nominal.carries]
    x, y = (np.array([getattr(world.ego, name)[0] for world in worlds]) for name in ("x", "y"))
    beside = np.abs(x - worlds[0].others.x[0, 0]) < 4.0
    assert beside.sum() > 1
    assert (y[beside] > 4.0).all()
    assert abs(y[-1] - 1.75) < 1.0


def test_the_noise_free_drive_is_plausible(problem):
    drives = drive(problem, np.zeros((1, problem.steps + 1, problem.noise_size)))
    assert drives.start[0] > 4.0
    assert drives.levels["lateral_acceleration"][0] <= 4.0 * 1.05
    assert drives.levels["combined_g"][0] < 0.6
    assert drives.levels["gap"][0] > 1.0


@pytest.mark.slow
def test_noisy_drives_stay_below_one_g(problem):
    drives = drive_many(problem, 50, seed=4)
    assert (drives.levels["combined_g"] < 1.0).all()
    assert np.isfinite(drives.levels["jerk"]).all()


def test_it_begins_with_tracks_of_those_whom_the_sensor_sees(problem):
    loop = problem.system
    state = loop.initial(np.random.default_rng(0).standard_normal((300, loop.noise_size)))
    exists = loop.tracker.estimate(state.track).exists.mean(axis=0)
    assert 0.02 < exists[0] < 0.6  # 130 to 190 m ahead
    assert exists[1:].min() > 0.8


@pytest.mark.slow
def test_without_errors_of_perception_nobody_is_hit_and_nothing_brakes_abruptly():
    outcome = simulate(problem_of("perception=null"), 300)
    assert not outcome.error.any()
    assert outcome.violated.sum(axis=0)[[1, 4]].tolist() == [0, 0]


@pytest.mark.slow
def test_ten_metres_change_no_probability_by_a_factor_of_three(problem):
    moved = problem_of("simulator.ego.x=10"), problem_of("simulator.ego.x=-10")
    counts = [simulate(each, 500).violated.sum(axis=0) for each in (problem, *moved)]
    often = counts[0] > 20  # of the others 500 drives say nothing
    assert often.sum() == 3
    for moved in counts[1:]:
        ratio = moved[often] / counts[0][often]
        assert (ratio > 1.0 / 3.0).all()
        assert (ratio < 3.0).all()
