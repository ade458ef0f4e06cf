"""A number that was changed on the disk is noticed and its file named; files without a checksum are read."""

import copy
import json

import pytest

from avrare.analysis.check import baseline_files
from avrare.base.errors import UsageError
from avrare.base.stored_files import CHECKSUM
from avrare.cli.main import main
from avrare.estimation.loop.checkpoint import Checkpoint, read_index
from avrare.results.run import Run

WALK = """\
name: walk
steps: 3
simulator: {plugin: linear, dt: 0.1, states: [x], A: [[1]], process_noise: [0.2], initial: {mean: [0]}}
specifications:
  near: {stl: "always (x < 0.5)"}
estimator: {plugin: mc, rollouts: 100}
thresholds: [{specification: near, probability: "< 0.9"}]
"""
READ = {"result": lambda path: Run.read(path.parent), "baseline": baseline_files.read}


@pytest.fixture(scope="module")
def night(tmp_path_factory):
    """Return a folder with a scenario, its run and its baseline, and the text of each of their files."""
    folder = tmp_path_factory.mktemp("night")
    (folder / "walk.yaml").write_text(WALK)
    words = ["--out", str(folder / "run"), "--quiet", "--no-pictures"]
    assert main(["run", str(folder / "walk.yaml"), *words]) == 0
    assert main(["check", str(folder / "walk.yaml"), "--save", "--quiet"]) == 0
    return folder


@pytest.fixture
def result(night):
    """Return the file result.json, restored afterwards."""
    yield from kept(night / "run" / "result.json")


@pytest.fixture
def baseline(night):
    yield from kept(night / "baselines" / "walk" / "0001.json")


def kept(path):
    text = path.read_text()
    yield path
    path.write_text(text)


def leaves(value, path=()):
    """Return paths of all numbers, texts and truth values but the wall times."""
    pairs = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, item in pairs:
        if key not in ("seconds", CHECKSUM):
            yield from leaves(item, (*path, key))
    if not isinstance(value, dict | list) and value is not None:
        yield path


def nudged(content, path):
    """Return the same with the least change of one leaf."""
    changed = copy.deepcopy(content)
    *way, last = path
    parent = changed
    for step in way:
        parent = parent[step]
    value = parent[last]
    if isinstance(value, bool):
        parent[last] = not value
    elif isinstance(value, float):
        parent[last] = value * (1 + 2**-52) if value else 5e-324
    else:
        parent[last] = value + 1 if isinstance(value, int) else value + "x"
    return changed


@pytest.mark.parametrize("kind", ["result", "baseline"])
def test_every_change_of_a_value_is_noticed(kind, request):
    path, read = request.getfixturevalue(kind), READ[kind]
    content = json.loads(path.read_text())
    places, refused = list(leaves(content)), 0
    assert len(places) > 20
    for place in places:
        path.write_text(json.dumps(nudged(content, place)))
        with pytest.raises(UsageError) as caught:
            read(path)
        assert str(path) in caught.value.message
        assert "restore the file" in caught.value.hint or "run the scenario again" in caught.value.hint
        refused += "its checksum does not fit" in caught.value.message
    assert refused > len(places) // 2


@pytest.mark.parametrize("kind", ["result", "baseline"])
def test_another_layout_wall_time_or_an_old_file_is_read(kind, request):
    path, read = request.getfixturevalue(kind), READ[kind]
    content = json.loads(path.read_text())
    slower = copy.deepcopy(content)
    slower["estimates"][0]["seconds"] += 100.0
    old = {key: value for key, value in content.items() if key not in (CHECKSUM, "files")}
    for one in (dict(reversed(content.items())), slower, old):
        path.write_text(json.dumps(one))
        read(path)


def test_commands_name_the_file(night, result, baseline, capsys):
    for path in (result, baseline):
        text = path.read_text()
        probability = json.loads(text)["estimates"][0]["probability"]
        path.write_text(text.replace(f'"probability": {probability}', '"probability": 0.25', 1))
        assert path.read_text() != text
    assert main(["report", str(result.parent)]) == 4
    assert "run/result.json: it was changed after it was written" in capsys.readouterr().err
    assert main(["check", str(night / "walk.yaml"), "--quiet"]) == 4
    err = capsys.readouterr().err
    assert "0001.json: it was changed after it was written" in err
    assert "hint: restore the file, or remove it to use the previous baseline" in err


def test_a_changed_scenario_of_a_run_is_named(night, capsys):
    for path in kept(night / "run" / "scenario.yaml"):
        assert main(["report", str(night / "run")]) == 0
        assert "may differ from the scenario that was run" not in (night / "run" / "report.html").read_text()
        path.write_text(path.read_text().replace("< 0.9", "< 0.8"))
        assert main(["report", str(night / "run")]) == 0
        assert "may differ from the scenario that was run" in (night / "run" / "report.html").read_text()
        capsys.readouterr()
        assert main(["replay", "--run", str(night / "run")]) == 0
        assert "scenario.yaml: it was changed after the run" in capsys.readouterr().err


def test_a_scenario_that_is_a_link_is_not_shown(night, monkeypatch):
    """Hide it: or else the report of a stranger's run folder would give away a file from elsewhere."""
    monkeypatch.chdir(night)
    secret = night / "secret"
    secret.write_text("password: swordfish")
    for path in kept(night / "run" / "scenario.yaml"):
        path.unlink()
        path.symlink_to(secret)
        assert main(["report", str(night / "run"), "--safe"]) == 0
        page = (night / "run" / "report.html").read_text()
        assert "swordfish" not in page
        assert "this is a link to a file outside its folder" in page
        path.unlink()


def test_a_changed_index_of_a_checkpoint_is_named(tmp_path):
    folder = tmp_path / "checkpoint"
    Checkpoint.open(folder, {"budget": "steps=100", "seconds": 1})
    index = folder / "checkpoint.json"
    assert read_index(folder)["task"]["budget"] == "steps=100"
    index.write_text(index.read_text().replace("steps=100", "steps=900"))
    with pytest.raises(UsageError, match=r"checkpoint\.json: it was changed") as caught:
        read_index(folder)
    assert caught.value.hint == "restore the file, or start afresh in another folder"
    old = json.loads(index.read_text())
    del old[CHECKSUM]
    index.write_text(json.dumps(old))
    assert read_index(folder)["task"]["budget"] == "steps=900"
