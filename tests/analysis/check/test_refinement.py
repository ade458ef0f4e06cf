"""Half the integration step on the same tapes: what `validate --build` says of it."""

from pathlib import Path

import numpy as np

import avrare
from avrare.analysis.check import refinement
from avrare.rollout.loaded_scenario import load

SCENARIOS = Path(__file__).parents[3] / "scenarios"


def compare(name, *settings):
    scenario = load(SCENARIOS / f"{name}.yaml", settings)
    return refinement.compare_substeps(scenario.definition, scenario.stack)


def test_changes_of_signals_scores_and_verdicts_are_told():
    first, signals, *rules = compare("merging_traffic", "steps=12")
    assert first == "integration: substeps 2 in place of 1, 8 tapes, greatest changes:"
    changes = {name: float(change) for name, change in (entry.split() for entry in signals.split(", "))}
    assert 0.0 < changes["others_x"] < 0.5
    assert changes["ego_x"] < 0.5
    assert [line.split(":")[0].strip() for line in rules][-1] == "let_enter"
    assert all(line.endswith("of 8 verdicts") for line in rules)


def test_finer_steps_change_less():
    coarse, fine = (compare("merging_traffic", "steps=12", f"simulator.substeps={n}")[1] for n in (1, 8))
    change = [float(text.partition("others_x ")[2].partition(",")[0]) for text in (coarse, fine)]
    assert change[1] < 0.5 * change[0]


def test_a_number_that_half_the_step_loses_is_told(monkeypatch):
    def drive(stack, tapes):
        substeps = stack.loop.simulator.config.substeps
        return refinement.Drives({"gap": np.array([[2.0, np.inf, np.nan if substeps > 1 else 1.0]])}, {}, {})

    monkeypatch.setattr(refinement, "_drive", drive)
    assert compare("merging_traffic", "steps=2")[1:] == ["  gap nan"]


def test_a_simulator_without_the_option_cannot_tell():
    [line] = avrare.validate(SCENARIOS / "double_integrator.yaml", build=True).notes[-1:]
    assert line == "integration: the simulator has no `substeps`: whether its dt is small enough is not known"


def test_a_rollout_that_breaks_down_is_no_mistake_of_the_scenario(monkeypatch):
    def broken(stack, tapes):
        raise ValueError("too fast")

    monkeypatch.setattr(refinement, "_drive", broken)
    [line] = compare("merging_traffic", "steps=2")
    assert line == "integration: not compared, as a rollout breaks down: ValueError: too fast"
