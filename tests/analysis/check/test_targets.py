from pathlib import Path

import pytest

from avrare.analysis.check import targets
from avrare.analysis.check.baseline_files import Baseline
from avrare.analysis.check.pooling import SHARES
from avrare.analysis.check.targets import CheckTarget, estimate_look, load_targets, plan_check, plan_looks
from avrare.base.errors import UsageError
from avrare.estimation.combine.specifications import Execution
from avrare.estimation.plan.budget import Budget
from avrare.rollout.loaded_scenario import LoadedScenario
from avrare.scenario.load import load


def test_rounding_makes_no_check_inconclusive_and_other_warnings_stay(drive, estimate, monkeypatch):
    found = estimate(health={"rounding": "differs by 1e-9", "few_roots": "too few"})
    monkeypatch.setattr(targets, "estimate_scenario", lambda *args, **keywords: [found])
    scenario = LoadedScenario(load(drive()))
    look = plan_looks(None, None)[0]
    (result,) = estimate_look(scenario, ["in_lane"], look, Execution())
    assert result.health == {"few_roots": "too few"}


def test_only_comparisons_whose_size_is_left_to_auto_look_again(drive, estimate):
    path = drive()
    auto, fixed = (load(path, estimator=name) for name in ("auto", "mc"))
    baseline = Baseline(Path("0001.json"), {}, {}, None, {"in_lane": estimate(relative_error=0.1)})

    def plan(definition, *arguments, before=baseline, **options):
        target = CheckTarget(LoadedScenario(definition), Path("baselines"), True, before)
        return [look.share for look in plan_check([target], *arguments, **options)]

    assert plan(auto, None) == [0.5, 0.5]
    for looks in (
        plan(fixed, None),
        plan(auto, Budget("rollouts", 100)),
        plan(auto, None, save=True),
        plan(auto, None, before=None),
    ):
        assert looks == [1.0]
    assert plan(auto, Budget("rollouts", 100), True) == list(SHARES)
    with pytest.raises(UsageError, match="several looks need a budget"):
        plan(auto, None, True)


def test_an_estimate_is_as_exact_as_its_comparison_asks(drive, estimate):
    (target,) = load_targets([load(drive())], save=True)
    first, wide = target.find_goal(save=True), CheckTarget(target.scenario, target.folder, False, None)
    assert first == pytest.approx(0.107, abs=1e-3)
    assert wide.find_goal(save=False) is None
    goals = []
    for error in (0.05, first, 0.18, 0.5):
        baseline = Baseline(Path("0001.json"), {}, {}, None, {"rule": estimate(relative_error=error)})
        checked = CheckTarget(target.scenario, target.folder, True, baseline)
        assert checked.find_goal(save=True) == first
        goals.append(checked.find_goal(save=False))
    assert goals == pytest.approx([0.2, 0.185, 0.1158, 0.107], abs=1e-3)
