"""``avrare check`` of a catalogue: thresholds of rates as a gate."""

import json
from pathlib import Path
from xml.etree import ElementTree

import pytest

from avrare.cli import rate
from avrare.cli.main import main

SCENARIO = """\
name: tank
steps: 3
simulator: {plugin: tank, surge: 0.5}
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
  - {name: lake, scenario: tank.yaml, exposure: {count: 30, hours: 10.0}}
  - {name: known, scenario: tank.yaml, exposure: {per_hour: 2.0}}
thresholds:
  - {rule: calm, per_hour: "BOUND"}
  - {rule: dry, per_km: "< 1e3"}
"""


@pytest.fixture
def catalogue(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("GITHUB_ACTIONS", raising=False)
    Path("tank.yaml").write_text(SCENARIO)

    def catalogue(bound="< 1e4"):
        Path("c.yaml").write_text(CATALOGUE.replace("BOUND", bound))
        return "c.yaml"

    return catalogue


@pytest.mark.parametrize(
    ("bound", "code", "verdict"), [("< 1e4", 0, "pass"), ("< 1e-9", 1, "fail"), ("< RATE", 3, "inconclusive")]
)
def test_a_threshold_of_a_rate_becomes_an_exit_code(catalogue, capsys, bound, code, verdict):
    main(["rate", catalogue(), "--out", "first", "--json"])
    found = json.loads(capsys.readouterr().out)
    rate = {one["rule"]: one["per_hour"]["value"] for one in found["rules"]}["calm"]
    path = catalogue(bound.replace("RATE", f"{rate:.9g}"))
    assert main(["check", path, "--out", "out", "--json"]) == code
    checked = json.loads(capsys.readouterr().out)
    assert checked["verdict"] == verdict
    assert checked["scenes"] == found["scenes"]
    assert json.loads(Path("out/rate.json").read_text()) == checked


def test_a_server_reads_the_rows(catalogue, capsys):
    words = ["--junit", "j.xml", "--markdown", "m.md", "--out", "out", "--plain"]
    assert main(["check", catalogue("< 1e-9"), *words]) == 1
    (suite,) = ElementTree.parse("j.xml").getroot()
    assert suite.attrib["failures"] == "1"
    assert [case.attrib["name"] for case in suite] == ["dry < 1000 per km", "calm < 1e-09 per hour"]
    (failure,) = suite.iter("failure")
    assert "per hour" in failure.attrib["message"]
    assert "tanks" in Path("m.md").read_text()


def test_a_job_marks_the_threshold_that_fails(catalogue, capsys, monkeypatch):
    monkeypatch.setenv("GITHUB_ACTIONS", "true")
    monkeypatch.setenv("GITHUB_STEP_SUMMARY", "summary.md")
    assert main(["check", catalogue("< 1e-9"), "--out", "out", "--quiet"]) == 1
    (line,) = [one for one in capsys.readouterr().out.splitlines() if one.startswith("::")]
    assert line.startswith("::error file=c.yaml,line=9,title=tanks calm")
    assert "tanks" in Path("summary.md").read_text()


def test_a_check_resumes_in_the_folder_that_it_began(catalogue, capsys):
    path = catalogue()
    for command in ("rate", "check"):
        assert main([command, path, "--out", "out", "--resume", "--json"]) == 0
    first, second = capsys.readouterr().out.strip().split("\n}\n", 1)
    assert json.loads(first + "}") == json.loads(second)
    assert main(["check", path, "--resume"]) == 4


@pytest.mark.parametrize("option", ["--junit", "--markdown"])
def test_a_file_that_cannot_be_written_is_refused_before_the_run(catalogue, capsys, option):
    Path("folder").mkdir()
    assert main(["check", catalogue(), "--out", "out", option, "folder"]) == 4
    assert "folder: is a folder, not a file" in capsys.readouterr().err
    assert not Path("out").exists()


def test_an_interrupted_check_tells_how_the_check_goes_on(catalogue, capsys, monkeypatch):
    def interrupt(*args):
        raise KeyboardInterrupt

    monkeypatch.setattr(rate, "rate_catalogue", interrupt)
    for command in ("check", "rate"):
        assert main([command, catalogue(), "--out", "out"]) == 2
        assert f"resume with avrare {command} c.yaml --out out --resume\n" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["--seed", "3"], "seed is an option of scenarios"),
        (["--seed", "0"], "seed is an option of scenarios"),
        (["--set", "seed=3"], "set is an option of scenarios"),
        (["--save"], "save is an option of scenarios"),
        (["--require-baseline"], "require baseline is an option of scenarios"),
        (["--plan"], "plan is an option of scenarios"),
        (["tank.yaml"], "is a catalogue, which is checked alone"),
    ],
)
def test_what_has_no_meaning_for_rates_is_refused(catalogue, capsys, words, text):
    assert main(["check", catalogue(), *words]) == 4
    assert text in capsys.readouterr().err
    assert not Path("runs").exists()


def test_a_catalogue_in_place_of_a_scenario_is_named(catalogue, capsys):
    assert main(["run", catalogue()]) == 4
    error = capsys.readouterr().err
    assert "c.yaml: is a catalogue of scenes, and no scenario" in error
    assert "hint: avrare rate c.yaml" in error


def test_a_catalogue_is_validated_with_its_scenes(catalogue, capsys):
    assert main(["validate", catalogue()]) == 0
    assert capsys.readouterr().out == "c.yaml: ok  tanks, a catalogue of 2 scenes and 2 rules\n"
    Path("tank.yaml").write_text(SCENARIO.replace("surge", "surg"))
    assert main(["validate", "c.yaml"]) == 4
    assert "did you mean 'surge'?" in capsys.readouterr().err
