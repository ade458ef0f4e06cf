"""The lane change: plausible without noise, every rule kept and none at its edge, each of them breakable."""

import sys
from pathlib import Path

import numpy as np
import pytest

from avrare.driving.geometry import Rectangle, other_rectangles, signed_distance
from avrare.rollout.loaded_scenario import LoadedScenario
from avrare.scenario.load import load

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "benchmarks"))

from lane_change_levels import drive, drive_many  # noqa: E402

RULES = ("safe_distance", "no_abrupt_braking", "traffic_flow", "left_traffic", "no_collision")


@pytest.fixture(scope="module")
def scenario():
    return LoadedScenario(load(ROOT / "scenarios" / "lane_change.yaml"))


@pytest.fixture(scope="module")
def problem(scenario):
    return scenario.problem(RULES)


@pytest.fixture(scope="module")
def nominal(problem):
    return drive(problem, np.zeros((1, problem.steps + 1, problem.noise_size)))


def test_it_names_neither_backend_nor_chunk_and_gets_the_defaults(scenario):
    controller = scenario.definition.controller.config
    assert {"backend", "search"}.isdisjoint(controller.model_fields_set)
    assert controller.search == "everywhere"
    assert scenario.definition.chunk is None


def test_the_noise_free_drive_is_plausible(nominal):
    assert nominal.start[0] > 2.5
    assert nominal.levels["combined_g"][0] < 0.8
    assert nominal.levels["lateral_acceleration"][0] <= 4.0 * 1.05
    assert nominal.levels["gap"][0] > 1.0
    assert nominal.counts["friction_saturations"] == nominal.counts["fallback_solves"] == 0


def test_the_noise_free_drive_breaks_no_rule_and_is_at_no_edge(nominal):
    assert not nominal.violated.any()
    assert (nominal.robustness[0] > 0.05).all()


@pytest.mark.slow
def test_noisy_drives_stay_below_one_g(problem):
    drives = drive_many(problem, 50, seed=4)
    assert (drives.levels["combined_g"] < 1.0).all()
    assert np.isfinite(drives.levels["jerk"]).all()


def test_the_others_turn_gently_and_never_touch(scenario):
    others = scenario.stack.loop.simulator.traffic.at(np.arange(scenario.steps + 1))
    assert np.degrees(np.abs(others.heading)).max() < 10.0
    assert np.abs(others.acceleration).max() < 3.0
    boxes = other_rectangles(others, scenario.scene)
    one = [
        Rectangle(boxes.x[:, v], boxes.y[:, v], boxes.heading[:, v], boxes.length[v], boxes.width[v])
        for v in range(len(scenario.scene.names))
    ]
    for a in range(len(one)):
        for b in range(a):
            assert signed_distance(one[a], one[b]).min() > 0.2, (a, b)


@pytest.mark.slow
def test_the_drive_without_noise_swerves_round_the_parked_car_and_returns(problem, scenario):
    carries = problem.nominal(keep_carries=True).carries
    egos = [carry.system.world.ego for _, _, carry in carries]
    x, y = (np.array([getattr(ego, name)[0] for ego in egos]) for name in ("x", "y"))
    assert (y[np.abs(x - 40.0) < 4.0] > 4.0).all()
    assert abs(y[-1] - 1.75) < 1.0
    half = 0.5 * scenario.scene.ego_width
    assert y.max() + half < 7.0
    assert y.min() - half > 0.0
