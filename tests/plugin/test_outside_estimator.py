"""An estimator of another distribution takes every role that ours do, by what its component declares."""

from dataclasses import replace
from pathlib import Path
from statistics import NormalDist

import pytest

import avrare
from avrare.cli.main import main
from avrare.estimation.result.note import Note
from avrare.plugin.registry import default_registry
from avrare.results.run import Run
from avrare.scenario.json_schema import scenario_schema
from avrare.scenario.load import load

FOLDERS = ("plugin/widened", "analysis/check/toy")
LIMIT = 3.5
PROBABILITY = 1.0 - NormalDist().cdf(LIMIT)
SCENARIO = f"""\
name: gust
steps: 1
simulator: {{plugin: gusts}}
specifications:
  in_lane: {{stl: "always (offset < {LIMIT})"}}
"""


@pytest.fixture
def run(monkeypatch, tmp_path):
    """Return a function that runs the scenario with these settings; only two test plugins are let in."""
    for folder in FOLDERS:
        monkeypatch.syspath_prepend(str(Path(__file__).parents[1] / folder))
    monkeypatch.setenv("AVRARE_PLUGINS", "widened,gusts")
    monkeypatch.chdir(tmp_path)
    default_registry.cache_clear()
    Path("gust.yaml").write_text(SCENARIO)
    yield lambda *settings: avrare.run("gust.yaml", list(settings))["in_lane"]
    default_registry.cache_clear()


def test_it_is_a_candidate_of_auto(run):
    result = run("estimator={plugin: auto, rollouts: 20000}")
    low, high = result.interval
    assert result.estimator == "widened"
    assert low < PROBABILITY < high
    assert "a trial promises a gain" in str(result.diagnostics["choice"]["tried"])
    assert "avrare-widened" in load("gust.yaml").versions


def test_it_checks_an_estimator_of_another_family(run):
    result = run("estimator={plugin: mc, rollouts: 20000}", "cross_check={share: 0.3}")
    assert (result.cross_check.estimator, result.cross_check.outcome) == ("widened", "agree")
    named = run("estimator={plugin: mc, rollouts: 20000}", "cross_check={estimator: widened, share: 0.3}")
    assert named.cross_check.result.probability == result.cross_check.result.probability
    assert "avrare-widened" in load("gust.yaml", ["cross_check=true", "estimator={plugin: mc}"]).versions


def test_monte_carlo_checks_it_but_not_itself(run):
    result = run("estimator={plugin: widened}", "cross_check={share: 1.0}")
    assert result.cross_check.estimator == "mc"
    with pytest.raises(avrare.AvrareError, match="widened is of the same family as widened"):
        run("estimator={plugin: widened}", "cross_check={estimator: widened}")


def test_its_warning_can_be_suppressed(run):
    estimator = "estimator={plugin: widened}"
    text = "the noise is 1.5 times as wide as it is meant to be"
    assert run(estimator).health == {"widened_noise": text}
    assert not run(estimator, "suppress=[widened_noise]").health
    with pytest.raises(avrare.AvrareError, match="unknown health warning 'wide_noise'"):
        run(estimator, "suppress=[wide_noise]")


def test_its_notes_are_stored_and_shown(run, capsys):
    text = "The noise is 1.5 times as wide as it is meant to be."
    assert main(["run", "gust.yaml", "--set", "estimator={plugin: widened}", "--out", "out"]) == 0
    assert text in " ".join(capsys.readouterr().out.split())
    result = Run.read("out")["in_lane"]
    assert Note("widening", text) in result.notes
    assert text in result._repr_html_()
    assert text in result.report("report.html").read_text()


def test_its_charts_are_in_the_report(run):
    run("estimator={plugin: widened}").report("report.html")
    assert "Sorted weights" in Path("report.html").read_text()


def test_it_may_keep_no_robustness(run):
    result = replace(run("estimator={plugin: widened}"), robustness=None)
    page = result.report("report.html").read_text()
    assert "Sorted weights" in page
    assert "Histogram of the robustness" not in page
    assert len(result.plot().figure.axes) == 1


def test_without_the_plugin_its_names_are_unknown(run, monkeypatch):
    monkeypatch.setenv("AVRARE_PLUGINS", "gusts")
    default_registry.cache_clear()
    with pytest.raises(avrare.AvrareError, match="unknown health warning 'widened_noise'"):
        run("suppress=[widened_noise]")
    with pytest.raises(avrare.AvrareError, match="unknown estimator 'widened'"):
        run("cross_check={estimator: widened}")
    assert run("estimator={plugin: auto, rollouts: 6000}").estimator == "mc"


def test_without_another_family_nothing_checks_monte_carlo(run, monkeypatch):
    monkeypatch.setenv("AVRARE_PLUGINS", "gusts")
    default_registry.cache_clear()
    result = run("estimator={plugin: mc, rollouts: 500}", "cross_check=true")
    assert result.cross_check.outcome == "inconclusive"
    texts = {note.kind: note.text for note in result.notes}
    assert texts["cross_check"].startswith("Cross-check is inconclusive: no estimator of another family")


def test_the_schema_knows_it(run):
    properties = scenario_schema(default_registry())
    assert "widened_noise" in properties["properties"]["suppress"]["items"]["enum"]
    options = properties["$defs"]["CrossCheck"]["properties"]["estimator"]["anyOf"]
    assert options[0]["enum"] == ["mc", "widened"]
