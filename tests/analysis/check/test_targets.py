from avrare.analysis.check import targets
from avrare.analysis.check.targets import estimate_look, plan_looks
from avrare.estimation.combine.specifications import Execution
from avrare.rollout.loaded_scenario import LoadedScenario
from avrare.scenario.load import load


def test_rounding_makes_no_check_inconclusive_and_other_warnings_stay(drive, estimate, monkeypatch):
    found = estimate(health={"rounding": "differs by 1e-9", "few_roots": "too few"})
    monkeypatch.setattr(targets, "estimate_scenario", lambda *args, **keywords: [found])
    scenario = LoadedScenario(load(drive()))
    look = plan_looks(None, None)[0]
    (result,) = estimate_look(scenario, ["in_lane"], look, Execution())
    assert result.health == {"few_roots": "too few"}
