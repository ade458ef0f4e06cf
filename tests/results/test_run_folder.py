"""Folders of runs and the files in them; atomic writes: what they remove, and what they leave alone."""

import json
import os
from pathlib import Path

import pytest

import avrare
from avrare.base.atomic_files import remove_torn, write_atomic, write_text
from avrare.base.errors import UsageError
from avrare.base.plot import Plot
from avrare.base.stored_files import digest
from avrare.cli.main import main
from avrare.output.plots import make_figure
from avrare.results.run import Run
from avrare.results.run_folder import make_folder, make_new_folder
from avrare.results.stored_failures import select_failing
from avrare.testing.faulty_systems import Walk
from pushed_point import pushed_point

LEARNED = ("--estimator", "is", "--set", "estimator.rollouts=3000")


@pytest.fixture
def run(tmp_path, monkeypatch):
    """Run the scenario into the folder ``out`` with these words; return the folder."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "point.yaml").write_text(pushed_point(2.0))

    def run(*words):
        assert main(["run", "point.yaml", "--out", "out", "--no-pictures", "--quiet", *words]) == 0
        return tmp_path / "out"

    return run


def test_runs_of_the_same_second_have_separate_folders(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    folders = [make_new_folder(["lane_change"]) for _ in range(5)]
    assert len(set(folders)) == 5
    assert all(folder.is_dir() and folder.name.startswith("lane_change-") for folder in folders)


def test_a_named_folder_is_reused(tmp_path):
    assert [make_folder(tmp_path, "drive", several=False) for _ in range(2)] == [tmp_path, tmp_path]
    assert make_folder(tmp_path, "drive", several=True) == tmp_path / "drive"


def files_of(folder):
    return {path.name for path in folder.iterdir()}


def test_artifacts_of_an_earlier_run_are_removed(run):
    first = files_of(run())
    folder = run(*LEARNED)
    assert files_of(folder) == {*first, "learned.json"}
    recorded = json.loads((folder / "result.json").read_text())["files"]
    assert recorded["learned.json"] == digest((folder / "learned.json").read_text())
    assert files_of(run()) == first


def test_files_made_from_an_earlier_result_are_removed(run):
    first = files_of(run())
    names = ("why.json", "report.html", "nominal.png", "worst_left.png")
    for name in (*names, "mine.txt"):
        (run() / name).write_text("{}")
        assert files_of(run()) == first | ({"mine.txt"} & {name})


@pytest.mark.parametrize("name", ["../mine.txt", "..", "", "checkpoint", "/etc/hostname"])
def test_a_result_that_names_files_elsewhere_removes_nothing(run, name):
    folder = run()
    mine = folder.parent / "mine.txt"
    mine.write_text("mine")
    (folder / "checkpoint").mkdir()
    content = json.loads((folder / "result.json").read_text())
    content["files"][name] = "0"
    (folder / "result.json").write_text(json.dumps(content))
    run()
    assert mine.read_text() == "mine"


def test_a_run_that_was_read_is_written_again(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "point.yaml").write_text(pushed_point(2.0))
    avrare.run("point.yaml", out="a", estimator="is", budget="rollouts=3000")
    first = Run.read("a")
    assert first.reproduction == "avrare run a/scenario.yaml --budget rollouts=3000"
    name = next(iter(first))
    assert first[name].origin.call == first.reproduction
    first.write("b/c")
    again = Run.read("b/c")
    assert again.to_dict() == first.to_dict()
    assert again.changes == ()
    for file in ("learned.json", "scenario.yaml", "failures.npz", "rollouts.npz"):
        assert (tmp_path / "b/c" / file).read_bytes() == (tmp_path / "a" / file).read_bytes()
    assert again.write("b/c")[name].trace().robustness == first[name].worst.robustness
    assert (tmp_path / "b/c/learned.json").exists()


def test_a_changed_artifact_is_named(run):
    folder = run(*LEARNED)
    content = json.loads((folder / "learned.json").read_text())
    (folder / "learned.json").write_text(json.dumps(content))
    words = f"{folder}/learned.json: it was changed after the run, or is missing"
    assert Run.read(folder).changes == (words,)


def test_results_of_a_problem_are_written_without_a_scenario(tmp_path):
    problem = avrare.Problem(Walk(), avrare.stl("always (x < 1)"), steps=4)
    run = Run.of_results([avrare.estimate(problem, rollouts=50)]).write(tmp_path / "a")
    assert run.reproduction.startswith("avrare.estimate(problem, ")
    assert not (tmp_path / "a" / "scenario.yaml").exists()
    assert Run.read(tmp_path / "a").reproduction == ""


def test_failures_that_are_counted_but_gone(tmp_path):
    problem = avrare.Problem(Walk(), avrare.stl("always (x < 0.1)"), steps=4)
    Run.of_results([avrare.estimate(problem, rollouts=50)]).write(tmp_path)
    (tmp_path / "failures.npz").unlink()
    with pytest.raises(UsageError, match="failures of specification are counted, but not stored"):
        select_failing(Run.read(tmp_path))


def test_a_damaged_result_leaves_nothing_learned(tmp_path):
    problem = avrare.Problem(Walk(), avrare.stl("always (x < 1)"), steps=4)
    for name in ("result.json", "learned.json"):
        (tmp_path / name).write_text("{")
    Run.of_results([avrare.estimate(problem, rollouts=50)]).write(tmp_path)
    assert not (tmp_path / "learned.json").exists()


def test_a_result_of_another_format_is_refused(run):
    folder = run()
    file = folder / "result.json"
    file.write_text(file.read_text().replace('"schema": 1', '"schema": 2'))
    with pytest.raises(UsageError, match="its format is 2, and this version of avrare reads 1"):
        Run.read(folder)


@pytest.fixture
def torn(tmp_path, monkeypatch):
    """Return a temporary file whose writer was killed."""

    def die(*_):
        raise MemoryError

    with monkeypatch.context() as patch:
        patch.setattr(os, "replace", die)
        patch.setattr(os, "unlink", lambda _: None)
        with pytest.raises(MemoryError):
            write_text(tmp_path / "result.json", "half")
    (found,) = tmp_path.iterdir()
    return found


def test_only_own_temporary_files_are_removed(tmp_path, torn):
    others = [tmp_path / name for name in (".editor.tmp", ".result.json.abcdefgh.tmp", "x.avrare_1.tmp")]
    for other in others:
        other.write_text("of another program")
    remove_torn(tmp_path)
    assert sorted(tmp_path.iterdir()) == sorted(others)


def test_a_link_at_the_place_of_a_file_is_replaced_and_not_followed(tmp_path):
    mine, link = tmp_path / "mine", tmp_path / "result"
    mine.write_text("precious")
    plot = Plot(make_figure(1.0, 1.0))
    for write in (lambda: write_atomic(link, b"new"), lambda: plot.save(link)):
        link.unlink(missing_ok=True)
        link.symlink_to(mine)
        write()
        assert not link.is_symlink()
        assert mine.read_text() == "precious"


@pytest.mark.skipif(not hasattr(os, "openpty"), reason="a matter of Unix")
def test_a_device_is_written_to_and_not_replaced():
    ours, theirs = os.openpty()
    try:
        path = Path(os.ttyname(theirs))
        write_text(path, "told")
        assert os.read(ours, 100) == b"told"
        assert path.is_char_device()
    finally:
        os.close(ours)
        os.close(theirs)
