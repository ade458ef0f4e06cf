"""Runs of scenarios from Python."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

import avrare
from avrare.cli.main import main
from avrare.plugin.registry import default_registry

TOY = Path(__file__).parents[2] / "analysis" / "check" / "toy"
SCENARIO = """\
name: drive
steps: 1
simulator: {plugin: gusts}
controller: {plugin: driver}
specifications:
  in_lane: {stl: "always (offset < 1.6448536269514722)"}
  on_road: {stl: "always (offset < 6)"}
thresholds: [{specification: in_lane, probability: '< 0.2'}]
estimator: {plugin: mc, rollouts: 400}
chunk: 100
"""


@pytest.fixture
def scenario(monkeypatch, tmp_path):
    monkeypatch.syspath_prepend(str(TOY))
    monkeypatch.chdir(tmp_path)
    default_registry.cache_clear()
    Path("drive.yaml").write_text(SCENARIO)
    yield "drive.yaml"
    default_registry.cache_clear()


def estimates(folder):
    entries = json.loads((Path(folder) / "result.json").read_text())["estimates"]
    return [{**entry, "seconds": 0.0} for entry in entries]


def test_run_writes_what_the_command_writes(scenario):
    run = avrare.run(scenario, ["seed=3"], "python", workers=2)
    assert main(["run", scenario, "--seed", "3", "--out", "command", "--quiet"]) == 0
    assert estimates("python") == estimates("command")
    assert list(run) == ["in_lane", "on_road"]
    assert run.folder == Path("python")
    assert (run.verdict, run["in_lane"].verdict, run["on_road"].verdict) == ("pass", "pass", None)


def test_a_string_is_one_setting(scenario):
    run = avrare.run(scenario, "estimator.rollouts=50", "here")
    assert run["in_lane"].rollouts == 50
    assert avrare.load(scenario, "seed=3").definition.seed == 3
    for options in ({"parameters": "steps.x"}, {"parameters": ["steps"], "overrides": "steps.x=3"}):
        with pytest.raises(avrare.AvrareError, match=r"steps\.x"):
            avrare.sensitivity(scenario, specification="in_lane", **options)


def test_an_unguarded_script_gets_one_error(scenario, monkeypatch):
    Path("script.py").write_text('import avrare\navrare.run("drive.yaml", out="here", workers=2)\n')
    monkeypatch.setenv("PYTHONPATH", str(TOY))
    words = [sys.executable, "script.py"]
    done = subprocess.run(words, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 1
    assert done.stderr.count("Traceback") == 1
    assert "put the call under `if __name__" in done.stderr.splitlines()[-1]


def test_a_run_and_its_folder_are_drawn_traced_and_reported_alike(scenario):
    run = avrare.run(scenario, out="here")
    assert run.plot()._repr_png_() == avrare.plot(run)._repr_png_() == avrare.plot(run.results)._repr_png_()
    assert run._repr_html_() == run.results._repr_html_()
    worst = avrare.trace("here", specification="in_lane")
    assert worst.robustness == avrare.trace(run["in_lane"]).robustness == run["in_lane"].worst.robustness
    assert avrare.trace(run, 1, "in_lane").robustness == run["in_lane"].failures.robustness[1]
    assert avrare.trace(scenario, specification="in_lane").outcome == "passes"
    assert avrare.report("here") == avrare.report(run) == Path("here/report.html")
    assert avrare.report(run.results, "there.html").is_file()
    with pytest.raises(avrare.UsageError, match="the report has no folder"):
        avrare.report(run.results)


def test_comparisons_and_monitored_drives_are_drawn(scenario, tmp_path):
    comparison = avrare.compare(scenario, "mc", "rollouts=50", "in_lane", repeat=2)
    monitored = avrare.monitor(avrare.run(scenario, out="here"), specification="in_lane")
    for value in (comparison, monitored):
        file = avrare.plot(value).save(tmp_path / "plot.svg")
        assert file.read_text(encoding="utf-8").lstrip().startswith("<?xml")
        assert value._repr_html_().startswith("<pre>")


def test_a_faulty_scenario_leaves_no_folder(scenario):
    with pytest.raises(avrare.ScenarioError, match="rollout"):
        avrare.run(scenario, ["estimator.rollout=5"])
    assert not Path("runs").exists()
