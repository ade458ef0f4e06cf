"""The lane change as published: how it drives without noise, and that its numbers stay what they are."""

import json
from pathlib import Path

import numpy as np
import pytest

from avrare.base.errors import ScenarioError
from avrare.rollout.loaded_scenario import LoadedScenario
from avrare.rollout.noise import NoiseSource
from avrare.scenario.load import load
from rollout_requests import fresh

SCENARIOS = Path(__file__).parents[2] / "scenarios"
LANE_CHANGE = SCENARIOS / "lane_change_published.yaml"
TRUTH = SCENARIOS.parent / "docs" / "ground-truth" / "lane_change_published-2d8c8d69366df0e9.json"
RULES = ("safe_distance", "no_abrupt_braking", "traffic_flow", "left_traffic", "no_collision")


@pytest.fixture(scope="module")
def scenario():
    return LoadedScenario(load(LANE_CHANGE))


@pytest.fixture(scope="module")
def nominal(scenario):
    return scenario.problem(RULES).nominal(keep_carries=True)


def same_where_known(known, whole):
    """Tell whether every setting known before has its value still; options may have been added."""
    if isinstance(known, dict):
        return all(name in whole and same_where_known(value, whole[name]) for name, value in known.items())
    if isinstance(known, list):
        return len(known) == len(whole) and all(map(same_where_known, known, whole))
    return known == whole


def test_it_is_the_system_of_the_stored_ground_truth():
    known = json.loads(TRUTH.read_text(encoding="utf-8"))["system"]
    resolved = load(LANE_CHANGE).resolved
    assert resolved["controller"]["backend"] == "casadi"
    assert same_where_known(known, load(LANE_CHANGE, ["controller.backend=riccati", "chunk=250"]).resolved)


@pytest.mark.parametrize(
    ("backend", "robustness"),
    [
        ("casadi", [0.03064968358, 0.96511740254, 0.35393119074, -0.00141101388, 1.51309452659]),
        ("riccati", [0.03064968358, 0.96511739115, 0.35038301239, 0.00173482320, 1.51309443432]),
    ],
)
def test_the_first_rollout_is_the_one_it_has_always_been(backend, robustness):
    problem = LoadedScenario(load(LANE_CHANGE, [f"controller.backend={backend}"])).problem(RULES)
    found = problem.simulate(NoiseSource(0, problem.noise_size), fresh(1), scored=False)
    # to 1e-6: other machines round otherwise in the last bits
    assert found.robustness[0].tolist() == pytest.approx(robustness, abs=1e-6)


@pytest.mark.slow
def test_the_noise_free_rollout_keeps_every_rule(nominal):
    assert not nominal.error.any()
    assert not nominal.violated.any()
    assert (nominal.robustness > 0).all()


def test_the_noise_free_rollout_passes_the_parked_car_on_the_left_and_stays_on_the_road(nominal, scenario):
    egos = [carry.system.world.ego for _, _, carry in nominal.carries]
    x, y = (np.array([getattr(ego, name)[0] for ego in egos]) for name in ("x", "y"))
    beside = np.abs(x - 40.0) < 4.0
    assert (y[beside] > 4.0).all()
    assert y.max() + 0.5 * scenario.scene.ego_width < 7.0
    assert y.min() - 0.5 * scenario.scene.ego_width > 0.0
    assert (np.diff(x) > 0).all()


def test_no_solve_falls_back_without_noise(nominal):
    assert nominal.counts["fallback_solves"].sum() == 0
    assert nominal.counts["solves"].sum() >= 39


def test_a_rule_that_the_start_already_breaks_is_refused_by_rule_and_vehicle():
    near = LoadedScenario(load(LANE_CHANGE, ["simulator.vehicles.1.x=45"]))
    with pytest.raises(ScenarioError) as caught:
        near.problem("safe_distance")
    text = "\n".join(caught.value.lines())
    for part in ("specifications.safe_distance", "sample 0", "R_G1", "'cut_in'", "hint:"):
        assert part in text


def test_a_failed_solve_is_counted_and_the_rollout_continues():
    blind = LoadedScenario(load(LANE_CHANGE, ["steps=3"]))
    loop = blind.stack.loop
    tracker = loop.tracker
    predict = tracker.predict

    def lost(track, steps):
        found = predict(track, steps)
        return type(found)(np.full_like(found.x, np.nan), found.y)

    tracker.predict = lost
    outcome = blind.problem(RULES).nominal()
    assert not outcome.error.any()
    assert outcome.counts["fallback_solves"].tolist() == [3]
