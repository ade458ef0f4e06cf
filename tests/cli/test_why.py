"""``avrare why`` on a run folder."""

import json
import re

import pytest

from avrare.cli.main import main
from pushed_point import pushed_point

PLANE = pushed_point(1.0, specifications='  kept: {stl: "always (x < 90)"}\n')


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("why")
    (folder / "plane.yaml").write_text(PLANE)
    assert main(["run", str(folder / "plane.yaml"), "--out", str(folder / "run"), "--quiet"]) == 0
    return folder / "run"


def test_the_kinds_of_a_run_are_printed_and_written(run, tmp_path, capsys):
    assert main(["why", str(run), "--fresh", "0", "--out", str(tmp_path)]) == 0
    out = capsys.readouterr().out
    assert out.startswith("left: 1 kind of failure, together ")
    assert "x < 1 is violated first" in out
    written = json.loads((tmp_path / "why.json").read_text())
    [kind] = written["kinds"]["left"]["kinds"]
    assert kind["share"] == pytest.approx(1.0)
    assert kind["low"] < kind["probability"] < kind["high"]


def test_work_of_some_time_is_announced(run, monkeypatch, capsys):
    monkeypatch.setattr("avrare.cli.why._ANNOUNCED_SECONDS", 0.0)
    assert main(["why", str(run), "--shrink", "--fresh", "10"]) == 0
    shrinking, causes = capsys.readouterr().err.splitlines()
    work = r"left: 1 failure to shrink, in some 35 batches of rollouts each: about .*s"
    assert re.fullmatch(work, shrinking)
    work = r"left: some [\d,]+ rollouts for the causes, fewer with a smaller --fresh: about .*s"
    assert re.fullmatch(work, causes)
    assert main(["why", str(run), "--fresh", "10", "--quiet"]) == 0
    assert not capsys.readouterr().err


def test_json_is_all_that_is_printed(run, capsys):
    capsys.readouterr()
    assert main(["why", str(run), "--fresh", "0", "--json"]) == 0
    causes = json.loads(capsys.readouterr().out)
    assert set(causes["kinds"]) == set(causes["attribution"]) == {"left"}


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["--specification", "lft"], "unknown specification 'lft'"),
        (["--specification", "kept"], "no failure of kept is stored"),
    ],
)
def test_a_wrong_specification_is_a_clear_error(run, words, text, capsys):
    assert main(["why", str(run), *words]) == 4
    assert text in capsys.readouterr().err


def test_a_reader_that_leaves_early_leaves_no_checkpoint(run, tmp_path, monkeypatch):
    def leave(*lines, error=False):
        raise BrokenPipeError

    monkeypatch.setattr("avrare.cli.output.say", leave)
    assert main(["why", str(run), "--fresh", "10", "--out", str(tmp_path)]) == 0
    assert [path.name for path in tmp_path.iterdir()] == ["why.json"]
