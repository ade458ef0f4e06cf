"""The shipped lane change: how it drives without noise, and that its numbers repeat."""

from pathlib import Path

import numpy as np
import pytest

from avrare.base.errors import ScenarioError
from avrare.driving.geometry import Rectangle, other_rectangles, signed_distance
from avrare.estimation.loop import Settings, run
from avrare.estimation.monte_carlo import MonteCarlo
from avrare.estimation.monte_carlo_config import McConfig
from avrare.rollout.executors.processes import ProcessExecutor
from avrare.rollout.executors.serial import SerialExecutor
from avrare.rollout.loaded_scenario import LoadedScenario
from avrare.scenario.load import load

SCENARIOS = Path(__file__).parents[2] / "scenarios"
LANE_CHANGE = SCENARIOS / "lane_change.yaml"
RULES = ("safe_distance", "no_abrupt_braking", "traffic_flow", "left_traffic", "no_collision")


@pytest.fixture(scope="module")
def scenario():
    return LoadedScenario(load(LANE_CHANGE))


@pytest.fixture(scope="module")
def nominal(scenario):
    return scenario.problem(RULES).nominal(keep_carries=True)


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


@pytest.mark.parametrize("name", ["lane_change.yaml", "lane_change_paper.yaml"])
def test_the_scripted_vehicles_never_overlap(name):
    scenario = LoadedScenario(load(SCENARIOS / name))
    others = scenario.stack.loop.simulator.traffic.at(np.arange(scenario.steps + 1))
    boxes = other_rectangles(others, scenario.scene)
    vehicles = range(len(scenario.scene.names))
    one = [
        Rectangle(boxes.x[:, v], boxes.y[:, v], boxes.heading[:, v], boxes.length[v], boxes.width[v])
        for v in vehicles
    ]
    for a in vehicles:
        for b in range(a):
            assert signed_distance(one[a], one[b]).min() > 0.2, (a, b)


@pytest.mark.slow
def test_one_seed_gives_the_same_bits_for_one_worker_and_two():
    scenario = LoadedScenario(load(LANE_CHANGE, ["steps=12", "chunk=3"]))
    problem = scenario.problem(RULES)
    results = [
        run(problem, MonteCarlo(McConfig(rollouts=8)), executor, Settings(seed=4))
        for executor in (SerialExecutor(), SerialExecutor(), ProcessExecutor(2))
    ]
    for other in results[1:]:
        for a, b in zip(results[0], other, strict=True):
            assert a.robustness.tolist() == b.robustness.tolist()
            assert {**a.to_dict(), "seconds": 0} == {**b.to_dict(), "seconds": 0}


@pytest.mark.slow
def test_particles_do_not_depend_on_their_neighbours(scenario):
    short = LoadedScenario(load(LANE_CHANGE, ["steps=8"])).problem(RULES)
    tape = np.random.default_rng(5).normal(size=(5, short.steps + 1, short.noise_size))
    together = short.replay(tape).robustness
    alone = np.concatenate([short.replay(tape[i : i + 1]).robustness for i in range(len(tape))])
    assert together.tolist() == alone.tolist()


def test_a_rule_that_the_start_already_breaks_is_refused_by_rule_and_vehicle():
    near = LoadedScenario(load(LANE_CHANGE, ["simulator.vehicles.1.x=45"]))
    with pytest.raises(ScenarioError) as caught:
        near.problem("safe_distance")
    text = "\n".join(caught.value.lines())
    assert "specifications.safe_distance" in text
    assert "sample 0" in text
    assert "R_G1" in text
    assert "'cut_in'" in text
    assert "hint:" in text


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
