"""Scenes with estimators of their own: rare failures in a catalogue's rates."""

import json
import math
from pathlib import Path
from statistics import NormalDist

import pytest

import avrare
from avrare.analysis.page.rates import build_rates
from avrare.analysis.page.rates_model import RatesModel
from avrare.analysis.rates.catalogue import load_catalogue
from avrare.analysis.rates.rates import compute, divide
from avrare.analysis.rates.scene_estimates import SceneEstimate
from avrare.base.errors import ExitCode, ScenarioError, UsageError
from avrare.cli.main import main
from avrare.estimation.plan.budget import Budget
from avrare.output.html.page import render_rates
from plain_results import plain_result

# The inflows of the four samples are independent, so that both probabilities are known.
SEA = """\
name: sea
steps: 3
simulator: {plugin: tank, memory: 0.001}
specifications:
  dry: {stl: "always (inflow < 0.0444)"}
  calm: {stl: "always (inflow < 0.012)"}
estimator: {plugin: ess, chains: 20, runs: 4, specifications: [dry]}
"""
OWN = "{plugin: ess, chains: 20, runs: 4, specifications: [dry]}"
CATALOGUE = f"""\
name: seas
budget: {{rollouts: 700}}
pilot: 50
scenes:
  - {{name: usual, scenario: sea.yaml, set: ["simulator.surge=0.6"], exposure: {{count: 30, hours: 10.0}}}}
  - {{name: quiet, scenario: sea.yaml, exposure: {{per_hour: 5.0}}, estimator: {OWN}}}
thresholds:
  - {{rule: dry, per_hour: "< 1.0"}}
  - {{rule: calm, per_hour: "< 1e-6"}}
"""


def exact(limit, surge=0.4):
    return 1.0 - NormalDist().cdf(math.log(limit / 0.008) / surge) ** 4


@pytest.fixture
def catalogue(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("sea.yaml").write_text(SEA)

    def catalogue(*changes):
        text = CATALOGUE
        for old, new in changes:
            assert old in text
            text = text.replace(old, new)
        Path("c.yaml").write_text(text)
        return "c.yaml"

    return catalogue


def counted(failures, rollouts):
    return SceneEstimate(plain_result(failures=failures, rollouts=rollouts))


def own(probability, low, high, **fields):
    fields = {"estimator": "ess", "failures": 9, "rollouts": 900} | fields
    return SceneEstimate(plain_result(probability=probability, interval=(low, high), **fields), True)


def test_a_rare_scene_is_estimated_by_its_own_estimator(catalogue, capsys):
    path = catalogue(("chains: 20, ", ""), ("per_hour: 5.0", "per_hour: 5000.0"))
    assert main(["rate", path, "--out", "one", "--plain"]) == ExitCode.FAIL
    shown = capsys.readouterr().out
    assert "quiet  dry   ess" in shown
    assert "does not lead to could add" in shown
    assert "dry < 1 per hour: pass" in shown
    found = json.loads(Path("one/rate.json").read_text())
    quiet = found["scenes"][1]
    stored = json.loads(Path("one/own/quiet/result.json").read_text())["estimates"]
    assert [one["specification"] for one in stored] == ["dry"]
    estimate = quiet["estimates"]["dry"]
    assert estimate["interval"] == stored[0]["interval"]
    assert estimate["interval"][0] < exact(0.0444) < estimate["interval"][1]
    assert set(quiet["failures"]) == {"calm"}  # the other rule has a share of the Monte Carlo rollouts
    assert quiet["rollouts"] > estimate["rollouts"] > 0
    truth = 3.0 * exact(0.0444, 0.6) + 5000.0 * exact(0.0444)
    low, high = found["rules"][0]["per_hour"]["interval"]
    assert low < truth < high
    assert found["rules"][0]["blind_bound_per_hour"] == pytest.approx(5000.0 * estimate["blind_bound"])
    page = Path("one/report.html").read_text()
    assert "Estimators of the scenes’ own" in page
    assert "by ess" in page


def test_workers_and_interruptions_change_no_bit(catalogue, capsys, monkeypatch):
    path = catalogue()
    main(["rate", path, "--out", "one", "--quiet"])
    main(["rate", path, "--out", "two", "--quiet", "--workers", "2"])
    whole = Path("one/rate.json").read_bytes()
    assert Path("two/rate.json").read_bytes() == whole

    from avrare.cli import rate

    run, calls = rate.estimate_run, []

    def interrupt(*arguments):
        calls.append(arguments[0].name)
        if len(calls) == 3:
            raise KeyboardInterrupt
        return run(*arguments)

    monkeypatch.setattr("avrare.cli.rate.estimate_run", interrupt)
    assert main(["rate", path, "--out", "three", "--quiet"]) == ExitCode.INTERRUPTED
    assert calls[0] == "quiet"  # the rare scenes come first: their rates weigh in the shares of the others
    main(["rate", path, "--out", "three", "--resume", "--quiet"])
    assert calls[3:].count("quiet") == 2  # its pilot and its share; what is finished is read
    assert Path("three/rate.json").read_bytes() == whole


@pytest.mark.parametrize("estimator", ["scenario", "auto", "mc"])
def test_an_estimator_is_named_by_a_word(catalogue, estimator):
    read = load_catalogue(catalogue((OWN, estimator)))
    scenario = read.scenario(1, "own", 0)
    assert scenario.estimator.plugin == {"scenario": "ess"}.get(estimator, estimator)
    assert read.own_rules == ((), ("dry",) if estimator == "scenario" else ("dry", "calm"))
    assert read.list_shared_rules(1) == (("calm",) if estimator == "scenario" else ())
    assert scenario.confidence == 0.95
    assert scenario.seed not in [read.scenario(0, phase, 50).seed for phase in ("pilot", "scenes")]


def test_overrides_of_the_own_estimator_are_not_those_of_monte_carlo(catalogue):
    entry = "name: quiet, scenario: sea.yaml"
    path = catalogue((OWN, "scenario"), (entry, f'{entry}, set: ["estimator.runs=7", "simulator.surge=0.3"]'))
    read = load_catalogue(path)
    assert read.scenario(1, "own", 0).estimator.config.runs == 7
    plain = read.scenario(1, "scenes", 50)
    assert plain.estimator.config.rollouts == 50
    assert plain.simulator.config.surge == read.scenario(1, "own", 0).simulator.config.surge == 0.3


@pytest.mark.parametrize(
    ("new", "place", "words"),
    [
        ("{plugin: ess, chainz: 20}", "6:91", "scenes.1.estimator.chainz: unknown key"),
        ("{plugin: ess, chains: 1}", "6:99", "scenes.1.estimator.chains"),
        ("{plugin: esz}", "6:86", "did you mean 'ess'?"),
        ("{chains: 20}", "6:66", "scenes.1.estimator.plugin: required, but missing"),
        ("scenarios", "6:77", "did you mean 'scenario'?"),
        ("{plugin: ess, specifications: [dyr]}", "6:108", "did you mean 'dry'?"),
        ("auto, budget: {rolouts: 7}", "6:92", "did you mean 'rollouts'?"),
    ],
)
def test_mistakes_have_their_place(catalogue, new, place, words):
    with pytest.raises(ScenarioError) as caught:
        load_catalogue(catalogue((OWN, new)))
    error = "\n".join(caught.value.lines())
    assert f"c.yaml:{place}: " in error
    assert words in error


def test_safe_mode_looks_into_the_own_estimator(catalogue, capsys):
    path = catalogue((OWN, "{plugin: is, learned: ../learned.json}"), ('set: ["simulator.surge=0.6"], ', ""))
    assert main(["rate", path, "--safe"]) == ExitCode.USAGE
    error = capsys.readouterr().err
    assert "c.yaml:6:99: scenes.1.estimator.learned: safe mode: " in error


def test_a_budget_is_required_where_scenes_share_it(catalogue):
    with pytest.raises(ScenarioError, match=r"c\.yaml:1:1: budget: required, but missing"):
        load_catalogue(catalogue(("budget: {rollouts: 700}\n", "")))
    usual = '"simulator.surge=0.6"], exposure: {count: 30, hours: 10.0}'
    path = catalogue(("budget: {rollouts: 700}\n", ""), (OWN, "mc"), (usual, f"{usual}, estimator: mc"))
    read = load_catalogue(path)
    assert read.budget(None) is None
    with pytest.raises(UsageError, match="no scene shares a budget"):
        read.budget(Budget("rollouts", 700))


def test_a_catalogue_of_own_estimators_needs_no_pilot(catalogue):
    fixed = "{plugin: mc, rollouts: 300}"
    usual = '"simulator.surge=0.6"], exposure: {count: 30, hours: 10.0}'
    path = catalogue(("budget: {rollouts: 700}\n", ""), (OWN, fixed), (usual, f"{usual}, estimator: {fixed}"))
    assert main(["rate", path, "--out", "out", "--quiet"]) in (0, 1, 3)
    assert [scene["rollouts"] for scene in json.loads(Path("out/rate.json").read_text())["scenes"]] == [
        300
    ] * 2
    assert not Path("out/pilot").exists()
    assert main(["rate", path, "--out", "out", "--resume", "--quiet"]) in (0, 1, 3)


@pytest.mark.parametrize(
    ("amount", "kind", "taken"),
    [("rollouts: 90", "rollouts", 90), ("steps: 90", "rollouts", 30), ("rollouts: 90", "steps", 270)],
)
def test_a_scene_s_budget_is_taken_off_the_catalogue_s(catalogue, amount, kind, taken):
    read = load_catalogue(catalogue((f"estimator: {OWN}", f"estimator: {OWN}, budget: {{{amount}}}")))
    pilot = [
        dict.fromkeys(read.rules, counted(5, 50)),
        {"calm": counted(5, 50)},
    ]
    whole = 3000.0 if kind == "rollouts" else 9000.0
    cost = 1 if kind == "rollouts" else 3
    shares = divide(read, Budget(kind, whole), [3, 3], pilot)
    assert sum(shares) * cost == pytest.approx(whole - taken - 100 * cost, abs=2 * cost)
    with pytest.raises(UsageError, match="own budgets cost"):
        divide(read, Budget(kind, 100.0 * cost + taken), [3, 3], pilot)


def test_a_scene_s_budget_is_divided_among_rules_that_are_estimated_apart(catalogue):
    both = "{plugin: ess, chains: 20}"
    read = load_catalogue(catalogue((OWN, f"{both}, budget: {{rollouts: 90}}")))
    assert read.own_estimator_budget(1) == Budget("rollouts", 45.0)
    together = load_catalogue(catalogue((OWN, "mc, budget: {rollouts: 90}")))
    assert together.own_estimator_budget(1) == Budget("rollouts", 90.0)
    assert load_catalogue(catalogue()).own_estimator_budget(1) is None


def test_the_rates_of_rare_scenes_weigh_in_the_shares_of_the_others(catalogue):
    read = load_catalogue(catalogue())
    pilot = [{"dry": counted(5, 50), "calm": counted(5, 50)}, {"calm": counted(5, 50)}]
    alone = divide(read, Budget("rollouts", 3000), [3, 3], pilot)
    much = divide(read, Budget("rollouts", 3000), [3, 3], pilot, [{}, {"dry": own(1e3, 0.9e3, 1.1e3)}])
    # With a large known part of its rate, rule dry no longer asks for rollouts of its only shared scene.
    assert much[0] < alone[0]
    assert much[1] > alone[1]


def test_an_interval_of_its_own_enters_the_sum_by_its_ends(catalogue):
    read = load_catalogue(catalogue())
    shared = {"dry": counted(0, 1000), "calm": counted(20, 1000)}
    rare = own(1e-4, 0.5e-4, 3e-4, blind_bound=2e-3)
    rate = compute(read, [shared, {"dry": rare, "calm": counted(1, 1000)}])
    total = rate.rates[0].totals["hour"]
    assert total.value == pytest.approx(5e-4)
    assert total.interval[0] == pytest.approx(5 * 0.5e-4)
    assert total.interval[1] > 5 * 3e-4
    assert rate.rates[0].blind == {"hour": pytest.approx(1e-2)}
    assert rate.rates[1].blind == {}
    assert rate.rollouts == (1000, 1900)


def test_the_blind_bound_of_a_scene_that_was_never_met_is_not_zero(catalogue):
    read = load_catalogue(catalogue(("per_hour: 5.0", "count: 0, hours: 10.0")))
    shared = {"dry": counted(0, 1000), "calm": counted(20, 1000)}
    rare = own(1e-4, 0.5e-4, 3e-4, blind_bound=2e-3)
    rate = compute(read, [shared, {"dry": rare, "calm": counted(1, 1000)}])
    assert rate.exposures[1].value == 0.0
    assert rate.rates[0].blind == {"hour": pytest.approx(2e-3 * rate.exposures[1].high)}


@pytest.mark.parametrize(
    ("probability", "warnings", "verdict"),
    [
        (1e-4, {}, "pass"),
        (1e-4, {"single_run": "t"}, "inconclusive"),
        (1e-4, {"solver_failures": "s"}, "inconclusive"),
        (0.9, {}, "fail"),
        (0.9, {"few_roots": "r"}, "inconclusive"),
        (0.9, {"solver_failures": "s"}, "fail"),
    ],
)
def test_a_warned_scene_leaves_the_verdict_open(catalogue, probability, warnings, verdict):
    read = load_catalogue(catalogue())
    scenes = [
        {"dry": counted(0, 9000), "calm": counted(0, 9000)},
        {"dry": own(probability, probability / 2, probability, health=warnings), "calm": counted(0, 9000)},
    ]
    decision = compute(read, scenes).rates[0].decisions[0]
    assert decision.verdict == verdict
    open_ = verdict == "inconclusive"
    assert decision.reasons == (tuple(f"quiet: {name}" for name in warnings) if open_ else ())


def test_warnings_are_told(catalogue, capsys):
    few = "{plugin: ams, particles: 4, discard: 2, runs: 2, specifications: [dry]}"
    path = catalogue((OWN, few), ("< 1.0", "< 1e4"))
    assert main(["rate", path, "--out", "out", "--plain"]) == ExitCode.FAIL
    shown = capsys.readouterr().out
    assert "quiet dry: warning extinct" in shown
    assert "inconclusive (quiet: extinct)" in shown
    content = json.loads(Path("out/rate.json").read_text())
    assert "extinct" in content["scenes"][1]["warnings"]["dry"]
    assert content["rules"][0]["thresholds"][0]["reasons"][0] == "quiet: extinct"
    assert "died out" in Path("out/report.html").read_text()


def result(**fields):
    fields |= {"failures": 2, "probability": 0.02, "interval": (0.01, 0.03), "rollouts": 400}
    return plain_result("dry", health={"rounding": "r", "model_unknown": "m"}, **fields)


def test_counts_of_an_ensemble_do_not_stand_for_its_models():
    # Its failures are of one model and its rollouts of all: 2 / 400 would be a quarter of the estimate.
    assert SceneEstimate(result()).quantity(0.95, False).value == 2 / 400
    model = SceneEstimate(result(members=1))
    found = model.quantity(0.95, False)
    assert (found.value, found.low, found.high) == (0.02, 0.01, 0.03)
    assert model.warnings == {"model_unknown": "m"}


def test_a_model_read_from_json_renders_the_same_page(catalogue):
    model = build_rates(avrare.rate(catalogue(), out="model"))
    assert any(table.lines for table in model.tables)
    assert any(rate.verdicts for rate in model.rates)
    assert render_rates(RatesModel.from_json(model.to_json())) == render_rates(model)
