"""docs/ci.md: the YAML parses, and the commands run on a toy."""

import configparser
import re
import shlex
from pathlib import Path

import pytest
import yaml

from avrare.analysis.check.targets import load_target
from avrare.base.errors import ExitCode
from avrare.cli.main import main
from avrare.scenario.load import load
from avrare.scenario.schema import Regression

TEXT = (Path(__file__).parents[3] / "docs" / "ci.md").read_text()
BLOCKS = re.findall(r"```(\w+)\n(.*?)```", TEXT, re.DOTALL)
BOUND = "thresholds: [{specification: in_lane, probability: '< 0.1'}]\n"


def blocks(language):
    return [text for kind, text in BLOCKS if kind == language]


def commands():
    """Return all avrare commands of the consoles and of the two pipelines."""
    github, gitlab, _ = map(yaml.safe_load, blocks("yaml"))
    steps = [step.get("run", "") for step in github["jobs"]["avrare"]["steps"]]
    lines = [line for text in [*blocks("console"), *steps] for line in text.splitlines()]
    lines += gitlab["gate"]["script"]
    stripped = (line.strip().removeprefix("$ ") for line in lines)
    return [shlex.split(line) for line in stripped if line.startswith("avrare ")]


def test_there_are_commands_to_run():
    assert len(commands()) == 5


def test_the_pipelines_have_the_keys_that_their_servers_need():
    github, gitlab, _ = map(yaml.safe_load, blocks("yaml"))
    assert {"name", "jobs"} <= set(github)  # `on` is read as a Boolean by YAML 1.1
    job = github["jobs"]["avrare"]
    assert all({"uses", "run"} & set(step) for step in job["steps"])
    assert gitlab["gate"]["allow_failure"]["exit_codes"] == ExitCode.INCONCLUSIVE
    assert gitlab["gate"]["artifacts"]["reports"]["junit"] == "report.xml"


@pytest.mark.parametrize("words", commands(), ids=" ".join)
def test_the_commands_run(drive, words):
    drive(BOUND)
    assert main(words[1:]) == 0
    for option, head in (("--junit", "<?xml"), ("--markdown", "### avrare check")):
        if option in words:
            assert Path(words[words.index(option) + 1]).read_text().startswith(head)
    assert Path("baselines/drive/0001.json").exists() == ("--save" in words)


def test_the_scenario_block_is_the_default(drive):
    *_, block = blocks("yaml")
    definition = load(drive(block))
    regression = definition.regression
    assert (regression.ratio, regression.excluded, regression.confidence) == (1.0, 2.0, 0.95)
    assert Regression().excluded == regression.excluded
    target = load_target(definition, Path("none"), True, False)
    assert [criterion.kind for criterion in target.planned_criteria] == [
        "threshold", "regression",
    ]  # fmt: skip


def test_the_pytest_settings_parse():
    parser = configparser.ConfigParser()
    (text,) = blocks("ini")
    parser.read_string(text)
    assert dict(parser["pytest"]) == {"avrare_scenarios": "scenarios/*.yaml", "avrare_inconclusive": "skip"}


def test_numbers_of_the_text():
    table = dict(re.findall(r"^\| (\d) \| (.*?) \|$", TEXT, re.MULTILINE))
    assert {int(code) for code in table} == {int(code) for code in ExitCode} - {70}
