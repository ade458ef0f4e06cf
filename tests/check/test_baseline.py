"""Numbered files that say what was found, and refuse to be anything else."""

import json
import math

import pytest

from avrare.check import baseline
from avrare.check.baseline import Entry
from avrare.check.evidence import Binomial, LogNormal
from avrare.errors import UsageError
from avrare.scenario.load import load


@pytest.fixture
def scenario(drive):
    return load(drive())


def test_files_are_numbered_and_the_newest_is_read(scenario, estimate, tmp_path):
    folder = tmp_path / "deep" / "folder"
    assert baseline.newest(folder) is None
    first = baseline.save(folder, scenario, [estimate(Binomial(5, 1000))])
    (folder / "notes.txt").write_text("no baseline")
    (folder / "0007.json").write_bytes(first.read_bytes())
    second = baseline.save(folder, scenario, [estimate(LogNormal(1e-3, 0.1, 9), health={"ties": "..."})])
    assert (first.name, second.name) == ("0001.json", "0008.json")
    found = baseline.newest(folder)
    assert found.path == second
    assert found.entries["rule"].health == ("ties",)
    assert found.entries["rule"].evidence == LogNormal(1e-3, 0.1, 9)
    assert found.scenario == scenario.resolved
    assert found.versions == scenario.versions
    assert found.versions["avrare-gusts"] == "1.0"


@pytest.mark.parametrize("law", [Binomial(0, 10), Binomial(5, 1000), LogNormal(1e-3, 0.1, 9)], ids=str)
def test_an_estimate_survives(scenario, estimate, tmp_path, law):
    result = estimate(law, relative_error=math.nan if law == Binomial(0, 10) else 0.1)
    path = baseline.save(tmp_path, scenario, [result])
    entry, wanted = baseline.read(path).entries["rule"], Entry.of(result)
    assert (entry.evidence, entry.probability, entry.rollouts) == (law, wanted.probability, 1000)
    assert entry.relative_error == pytest.approx(wanted.relative_error, nan_ok=True)


def test_the_default_folder_is_next_to_the_scenario(scenario, tmp_path):
    assert (tmp_path / baseline.default_folder(scenario)).resolve() == tmp_path / "baselines" / "drive"


@pytest.mark.parametrize(
    ("break_it", "message"),
    [
        (lambda text: text[:40], "not a baseline that can be read"),
        (lambda text: "[]", "not a baseline"),
        (lambda text: text.replace('"schema": 1', '"schema": 2'), "written in form 2"),
        (lambda text: text.replace('"law": "binomial"', '"law": "levy"'), "not an estimate"),
        (lambda text: json.dumps({**json.loads(text), "estimates": [{}]}), "no 'specification' in it"),
    ],
)
def test_a_damaged_file_is_refused_with_its_name(scenario, estimate, tmp_path, break_it, message):
    path = baseline.save(tmp_path, scenario, [estimate(Binomial(5, 1000))])
    path.write_text(break_it(path.read_text()))
    with pytest.raises(UsageError, match=message) as caught:
        baseline.newest(tmp_path)
    assert str(path) in caught.value.message
    assert "remove it" in caught.value.hint


def test_a_folder_that_cannot_be_written_to(scenario, estimate, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(UsageError, match="cannot"):
        baseline.save(tmp_path / "file", scenario, [estimate(Binomial(5, 1000))])
