"""Runs of a scenario with an ensemble: draws that cannot be reweighed, budgets, and a resumed run."""

import json

import pytest

from avrare.cli.main import main
from avrare.estimation import estimate
from feedback_loop import feedback_loop

LOOP = feedback_loop(2000)
DRAWS = "ensemble: {simulator.feedback.gain: [[[0.3, 0.4]], [[0.2, 0.4]], [[0.4, 0.4]]]}\n"


@pytest.fixture
def run(tmp_path, capsys):
    """Run LOOP with some more lines, and return the estimate as it is stored."""

    def run(name, more=""):
        file, folder = tmp_path / f"{name}.yaml", tmp_path / name
        file.write_text(LOOP + more)
        words = ["run", str(file), "--out", str(folder), "--no-pictures"]
        assert main(words) == 0, capsys.readouterr().err
        return read(folder)

    return run


def read(folder):
    [found] = json.loads((folder / "result.json").read_text())["estimates"]
    del found["seconds"]
    return found


def test_draws_that_cannot_be_reweighed_are_run_anew(run):
    alone, found = run("alone"), run("found", DRAWS)
    model = found["diagnostics"]["model"]
    same, loose, tight = model["members"]
    assert model["base"] == alone["probability"]
    assert same != alone["probability"], "a draw has noise of its own"
    assert loose > 1.2 * max(same, tight)
    assert found["rollouts"] == 4 * 2000
    assert found["probability"] == pytest.approx(sum(model["members"]) / 3)
    (low, high), (before, after) = found["interval"], alone["interval"]
    assert high / low > 1.5 * after / before


def test_an_interrupted_run_resumes_with_the_same_bits(run, tmp_path, monkeypatch):
    whole, members = run("whole", DRAWS), []
    task = estimate.LoadedScenario

    def dies(definition):
        members.append(definition)
        if len(members) == 3:
            raise KeyboardInterrupt
        return task(definition)

    with monkeypatch.context() as patched:
        patched.setattr(estimate, "LoadedScenario", dies)
        with pytest.raises(AssertionError):
            run("killed", DRAWS)
    assert main(["run", "--out", str(tmp_path / "killed"), "--resume", "--no-pictures"]) == 0
    assert read(tmp_path / "killed") == whole
