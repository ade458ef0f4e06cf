"""Catalogues: read, divided, run, resumed, judged; every mistake at its place."""

import json
from pathlib import Path

import pytest

import avrare
from avrare.analysis.rates.catalogue import load_catalogue
from avrare.analysis.rates.rates import compute, divide
from avrare.analysis.rates.scene_estimates import SceneEstimate
from avrare.base.errors import ExitCode, ScenarioError, UsageError
from avrare.cli.main import main
from avrare.estimation.plan.budget import Budget
from plain_results import plain_result

SCENARIO = """\
name: tank
steps: 3
simulator: {plugin: tank}
specifications:
  dry: {stl: "always (level < 1.6)"}
  calm: {stl: "always (level < 1.3)"}
"""
CATALOGUE = """\
name: tanks
speed: 50
budget: {rollouts: 700}
pilot: 50
scenes:
  - {name: calm_sea, scenario: tank.yaml, exposure: {count: 30, hours: 10.0}}
  - {name: storm, scenario: tank.yaml, set: ["simulator.surge=0.5"], exposure: {count: 4, km: 1000.0}}
  - {name: known, scenario: tank.yaml, exposure: {per_hour: 2.0}}
thresholds:
  - {rule: calm, per_hour: "< 1e4"}
"""


@pytest.fixture
def catalogue(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("tank.yaml").write_text(SCENARIO)

    def catalogue(text=CATALOGUE):
        Path("c.yaml").write_text(text)
        return "c.yaml"

    return catalogue


def seen(read, failures, rollouts):
    """Give every rule of three scenes the same counts."""
    estimate = SceneEstimate(plain_result(failures=failures, rollouts=rollouts))
    return [dict.fromkeys(read.rules, estimate)] * 3


def refused(path):
    with pytest.raises(ScenarioError) as caught:
        load_catalogue(path)
    return "\n".join(caught.value.lines())


def test_rules_are_those_that_all_scenes_have(catalogue):
    assert load_catalogue(catalogue()).rules == ("dry", "calm")


def test_scenes_have_seeds_and_settings_of_their_own(catalogue):
    read = load_catalogue(catalogue())
    found = [read.scenario(k, phase, 77) for phase in ("pilot", "scenes") for k in range(3)]
    assert len({one.seed for one in found}) == 6
    assert {one.estimator.config.rollouts for one in found} == {77}
    assert [one.name for one in found[:3]] == ["calm_sea", "storm", "known"]
    assert found[1].simulator.config.surge == 0.5


@pytest.mark.parametrize(
    ("old", "new", "place", "words"),
    [
        ("{count: 30, hours: 10.0}", "{count: 30}", "6:53", "count and counts need one of hours and km"),
        ("{per_hour: 2.0}", "{per_hour: 2.0, per_km: 1.0}", "8:50", "give one of count, counts, per_hour"),
        ("speed: 50\n", "", "1:1", "hours and km are mixed"),
        ("name: known", "name: storm", "1:1", "name of its own"),
        ("rule: calm", "rule: clam", "10:12", "did you mean 'calm'?"),
        ("pilot: 50", "pilot: 50\nrules: [dyr]", "5:9", "did you mean 'dry'?"),
        ("surge=0.5", "surg=0.5", "7:29", "this scenario has mistakes"),
        ("< 1e4", "< -1", "10:28", "an upper bound above 0"),
    ],
)
def test_mistakes_have_their_place(catalogue, old, new, place, words):
    assert old in CATALOGUE
    error = refused(catalogue(CATALOGUE.replace(old, new)))
    assert f"c.yaml:{place}: " in error
    assert words in error


def test_units_are_converted_by_the_speed(catalogue):
    read = load_catalogue(catalogue())
    counts = seen(read, 10, 100)
    rate = compute(read, counts).rates[0]
    assert rate.totals["hour"].value == pytest.approx(0.1 * (3.0 + 4e-3 * 50 + 2.0))
    assert rate.totals["km"].value == pytest.approx(rate.totals["hour"].value / 50)
    assert rate.totals["km"].interval == pytest.approx([x / 50 for x in rate.totals["hour"].interval])
    assert rate.totals["hour"].shares == pytest.approx((3.0 / 5.2, 0.2 / 5.2, 2.0 / 5.2))


@pytest.mark.parametrize(
    ("bound", "code"),
    [("< 1e4", ExitCode.PASS), ("< 1e-9", ExitCode.FAIL), ("< 0.52", ExitCode.INCONCLUSIVE)],
)
def test_thresholds_decide_the_exit_code(catalogue, bound, code):
    read = load_catalogue(catalogue(CATALOGUE.replace("< 1e4", bound)))
    rates = compute(read, seen(read, 10, 100))
    assert rates.exit_code == code
    assert compute(read, rates.estimates, ["storm"]).exit_code == ExitCode.ROLLOUT_ERRORS


def test_a_budget_that_is_too_small_is_refused(catalogue):
    read = load_catalogue(catalogue())
    pilot = seen(read, 0, 50)
    with pytest.raises(UsageError, match="the pilot alone costs 150 rollouts of 150"):
        divide(read, Budget("rollouts", 150), [3, 3, 3], pilot)
    assert sum(divide(read, Budget("steps", 3 * 700), [3, 3, 3], pilot)) in range(548, 551)
    with pytest.raises(UsageError, match="rollouts or steps"):
        read.budget(Budget("seconds", 10))


def test_a_catalogue_is_run_resumed_and_reported(catalogue, capsys):
    path = catalogue()
    assert main(["rate", path, "--out", "out", "--plain"]) == 0
    shown = capsys.readouterr().out
    assert "calm < 10000 per hour: pass" in shown
    first = json.loads(Path("out/rate.json").read_text())
    assert sum(scene["rollouts"] for scene in first["scenes"]) in range(548, 551)
    page = Path("out/report.html").read_text()
    assert all(name in page for name in ("calm_sea", "storm", "known", "per hour", "per km"))
    assert Path("out/scenes/storm/result.json").exists()

    assert main(["rate", path, "--out", "out"]) == 4
    assert "resume it, or choose another folder" in capsys.readouterr().err
    for name in ("rate.json", "scenes/storm/result.json"):
        Path("out", name).unlink()
    assert main(["rate", path, "--out", "out", "--resume", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == first
    assert json.loads(Path("out/rate.json").read_text()) == first


def test_scenes_that_were_never_met_share_by_the_upper_end_of_their_exposure(catalogue):
    text = CATALOGUE.replace("count: 30", "count: 0").replace("count: 4, km: 1000.0", "count: 0, hours: 90.0")
    read = load_catalogue(catalogue(text.replace("per_hour: 2.0", "count: 0, hours: 10.0")))
    shares = divide(read, Budget("rollouts", 700), [3, 3, 3], seen(read, 5, 50))
    assert shares == [pytest.approx(550 * 9 / 19, abs=1), pytest.approx(550 / 19, abs=1), shares[0]]
    rate = compute(read, seen(read, 5, 50)).rates[0].totals["hour"]
    assert rate.value == 0.0 < rate.interval[1]


def test_another_catalogue_is_not_mixed_with_the_old_one(catalogue, capsys):
    assert main(["rate", catalogue(), "--out", "out", "--quiet"]) == 0
    changed = CATALOGUE.replace("budget", "seed: 3\nbudget")
    assert main(["rate", catalogue(changed), "--out", "out", "--resume"]) == 4
    assert "contains the result of another run" in capsys.readouterr().err


def test_another_budget_is_refused_with_that_reason(catalogue, capsys):
    path = catalogue()
    assert main(["rate", path, "--out", "out", "--budget", "rollouts=400", "--quiet"]) == 0
    assert main(["rate", path, "--out", "out", "--resume"]) == 4
    assert 'begun with another budget: budget "rollouts=400" -> ' in capsys.readouterr().err
    assert main(["rate", path, "--out", "out", "--resume", "--budget", "rollouts=400", "--quiet"]) == 0


def test_the_resume_command_is_whole(catalogue, capsys, monkeypatch):
    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("avrare.cli.rate.estimate_run", interrupt)
    path = catalogue(CATALOGUE.replace('set: ["simulator.surge=0.5"], ', ""))
    main(["rate", path, "--out", "out", "--budget", "rollouts=400", "--safe"])
    command = f"avrare rate {path} --out out --resume --budget rollouts=400 --safe"
    assert f"resume with {command}" in capsys.readouterr().err


def test_the_function_writes_what_the_command_writes(catalogue):
    path = catalogue()
    assert main(["rate", path, "--out", "command", "--quiet"]) == 0
    rates = avrare.rate(path, out="python", workers=2)
    assert avrare.report(rates) == Path("python/report.html")
    for name in ("rate.json", "report.html"):
        assert Path("python", name).read_bytes() == Path("command", name).read_bytes()
    assert [row["unit"] for row in rates.table()] == ["hour", "km"] * 2
    assert any(line == "calm < 10000 per hour: pass" for line in rates.lines())
    with pytest.raises(UsageError, match="contains the run of a catalogue"):
        avrare.rate(path, out="python")
    assert avrare.rate(path, out="python", resume=True).table() == rates.table()


def test_a_catalogue_is_checked_as_scenarios_are(catalogue):
    outcome = avrare.check(catalogue())
    assert (outcome.verdict, int(outcome.exit_code)) == ("pass", 0)
    assert [row["required"] for row in outcome.table()] == ["< 10000 per hour"]
    with pytest.raises(UsageError, match="overrides is an option of scenarios"):
        avrare.check("c.yaml", overrides=["seed=3"])


GRID = """\
name: grid
budget: {rollouts: 300}
scenes:
  - {name: low, scenario: tank.yaml, cells: 30}
  - {name: high, scenario: tank.yaml, set: ["simulator.surge=0.5"], cells: 10}
thresholds:
  - {rule: calm, per_cell: "< 0.5"}
"""


def test_scenes_without_exposures_give_shares_of_cells(catalogue):
    read = load_catalogue(catalogue(GRID))
    estimates = [seen(read, failures, 100)[0] for failures in (20, 60)]
    rates = compute(read, estimates)
    assert list(rates.rates[0].totals) == ["cell"]
    assert rates.rates[0].totals["cell"].value == pytest.approx(0.75 * 0.2 + 0.25 * 0.6)
    assert rates.verdict == "pass"
    assert read.scenario(0, "scenes", 20).exposure is None
    assert sum(divide(read, Budget("rollouts", 300.0), [3, 3], estimates)) in (99, 100)


def test_a_share_of_cells_is_told_from_a_rate(catalogue, capsys):
    assert main(["rate", catalogue(GRID)]) in (0, 1, 3)
    assert "share of 40 cells, no exposure" in capsys.readouterr().out
    mixed = GRID.replace("cells: 30", "exposure: {per_hour: 2.0}")
    assert "a share of cells is not a rate" in refused(catalogue(mixed))
    assert "give the scene's exposure; or" in refused(catalogue(GRID.replace(", cells: 30", "")))
    both = GRID.replace('per_cell: "< 0.5"', 'per_cell: "< 0.5", per_km: "< 1"')
    assert "give one of per_hour, per_km and per_cell" in refused(catalogue(both))
