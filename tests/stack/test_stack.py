"""Parts that do not fit each other are refused, with the place; controllers that see the truth."""

import math
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from avrare import FormulaError, estimate
from avrare.cli.main import main
from avrare.driving import Action, Observation
from avrare.rollout.loaded_scenario import LoadedScenario
from avrare.scenario.load import load
from avrare.stack.closed_loop import ClosedLoop, LoopState
from avrare.stack.trial import _find_nan
from avrare_single_track.config import SingleTrackConfig
from avrare_single_track.simulator import build

SCENARIOS = Path(__file__).parents[2] / "scenarios"


@pytest.mark.parametrize(
    ("part", "block"),
    [
        ("controller", "{plugin: mpc}"),
        ("perception", "{plugin: gp_pem}"),
        ("perception", "{plugin: parametric}"),
        ("specifications.left", "{plugin: traffic_rules, rule: no_collision}"),
    ],
)
def test_parts_that_need_a_road_are_refused_without_one(part, block, capsys):
    words = ["validate", "--build", str(SCENARIOS / "double_integrator.yaml"), "--set", f"{part}={block}"]
    if part == "perception":
        words += ["--set", "tracker={plugin: imm}"]
    assert main(words) == 4
    error = capsys.readouterr().err
    assert f"{part}: " in error
    assert "driving simulator" in error
    assert "bug" not in error


def test_a_score_written_as_a_formula_guides_splitting():
    scored = "specifications.clear.score={stl: 'always (x < 9)'}"
    problem = LoadedScenario(load(str(SCENARIOS / "double_integrator.yaml"), (scored,))).problem("clear")
    result = estimate(problem, "ams", seed=0, particles=20, discard=10, runs=2)
    plain = estimate(problem.rescore(None), "ams", seed=0, particles=20, discard=10, runs=2)
    levels, others = (np.concatenate(found.diagnostics["levels"]) for found in (result, plain))
    assert levels.max() < -2.0 < others.min()  # x stays below 7


def test_a_score_of_missing_signals_is_refused():
    scored = "specifications.clear.score={stl: 'always (z < 1)'}"
    problem = LoadedScenario(load(str(SCENARIOS / "double_integrator.yaml"), (scored,))).problem("clear")
    with pytest.raises(FormulaError, match="'z'"):
        estimate(problem, "ams", seed=0, particles=20, discard=2, runs=2)


def test_a_start_that_raises_is_one_clear_line(monkeypatch, capsys):
    def broken(self, noise):
        raise ValueError("no battery\nat all")

    monkeypatch.setattr("avrare_linear.simulator.LinearSimulator.reset", broken)
    assert main(["validate", "--build", str(SCENARIOS / "double_integrator.yaml")]) == 4
    error = capsys.readouterr().err
    assert "the noise-free start raised ValueError: no battery at all" in error


@pytest.mark.parametrize(
    ("seen", "predicted", "told"),
    [
        ([np.nan, np.nan], 0.0, "perception: its observation is"),
        ([0.0, np.nan], np.nan, "tracker: its prediction is"),
        ([0.0, np.nan], 0.0, "controller: its action is"),
    ],
)
def test_the_first_part_with_a_nan_is_named(seen, predicted, told):
    """Leave out what a slot without a detection has, which is NaN by definition."""
    x = np.array([seen])
    state = LoopState(SimpleNamespace(ego=0.0), Observation(np.array([[True, False]]), x, x, x), None, None)
    parts = {"predict": lambda state: np.full(1, predicted), "act": lambda state: (math.nan, None)}
    loop = SimpleNamespace(controller=True, show=lambda world: world.ego, **parts)
    assert _find_nan(loop, [state, state]) == (told, 0)
    assert _find_nan(loop, [state]) is None


class Watcher:
    """Controller without a base class that keeps the last prediction."""

    horizon = 2

    def __init__(self, sees_truth):
        self.sees_truth = sees_truth

    def start(self, n):
        return None

    def act(self, memory, ego, prediction):
        self.seen = prediction
        zeros = np.zeros_like(ego.x)
        return Action(zeros, zeros), None


def loop_of(watcher):
    vehicle = {"name": "car", "x": 50.0, "y": 1.75, "speed": 10.0}
    options = {"dt": 0.2, "ego": {"x": 0.0, "y": 1.75, "speed": 20.0}, "vehicles": [vehicle]}
    return ClosedLoop(build(SingleTrackConfig.model_validate(options)), controller=watcher)


def test_a_controller_that_sees_the_truth_needs_no_tracker():
    watcher = Watcher(sees_truth=True)
    loop = loop_of(watcher)
    noise = np.zeros((3, loop.noise_size))
    state = loop.step(loop.initial(noise), noise)
    loop.step(state, noise)
    np.testing.assert_allclose(watcher.seen.x[:, 0], np.tile([52.0, 54.0, 56.0], (3, 1)))
    np.testing.assert_allclose(watcher.seen.y, 1.75)


def test_another_controller_gets_what_the_tracker_says():
    watcher = Watcher(sees_truth=False)
    loop = loop_of(watcher)
    noise = np.zeros((3, loop.noise_size))
    loop.step(loop.initial(noise), noise)
    assert watcher.seen is None
