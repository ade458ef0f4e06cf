"""An estimate from Python that is stopped in the midst goes on, to the same bits."""

import numpy as np
import pytest

import avrare
from avrare.base.errors import Interrupted
from avrare.estimation.loop import loop
from avrare.estimation.loop.checkpoint import Checkpoint
from avrare.estimation.loop.loop import run
from avrare.estimation.monte_carlo.config import McConfig
from avrare.estimation.monte_carlo.monte_carlo import MonteCarlo
from avrare.estimation.plan.budget import Budget
from avrare.estimation.plan.plan import Settings
from avrare.rollout.executors.serial import SerialExecutor
from avrare.testing import faulty_systems as systems
from avrare.worlds.capabilities import probe
from avrare_estimators.importance.config import IsConfig
from avrare_estimators.importance.importance_sampling import ImportanceSampling
from estimates import plain


def problem(lives=10**9, limit=0.9, steps=20, chunk=25, **options):
    system = systems.Mortal(systems.Walk(**options), lives)
    return avrare.Problem(system, avrare.stl(f"always (x < {limit})"), steps=steps, chunk=chunk)


def test_killed_after_every_batch(tmp_path):
    whole = avrare.estimate(problem(steps=3), rollouts=60)
    tried = problem(steps=3).system
    probe(tried, 3, branch=False)
    for lives in range(3 * 3):
        folder = tmp_path / str(lives)
        with pytest.raises(systems.Killed):
            avrare.estimate(problem(tried.lived + lives, steps=3), rollouts=60, checkpoint=folder)
        assert len(list(folder.rglob("*.npz"))) == lives // 3
        result = avrare.estimate(problem(steps=3), rollouts=60, checkpoint=folder)
        assert plain(result) == plain(whole)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"seed": 5}, "settings.seed 4 -> 5"),
        ({"rollouts": 500}, "options.rollouts 400 -> 500"),
        ({"confidence": 0.9}, "settings.confidence 0.95 -> 0.9"),
        ({"budget": "rollouts=50"}, "settings.budget null -> "),
    ],
)
def test_another_call_is_refused(tmp_path, change, told):
    call = {"seed": 4, "rollouts": 400, "checkpoint": tmp_path / "kept"}
    with pytest.raises(systems.Killed):
        avrare.estimate(problem(50), **call)
    with pytest.raises(avrare.UsageError) as caught:
        avrare.estimate(problem(), **{**call, **change})
    assert told in caught.value.message
    whole = avrare.estimate(problem(), seed=4, rollouts=400)
    assert plain(avrare.estimate(problem(), **call)) == plain(whole)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"chunk": 20}, "problem.chunk 25 -> 20"),
        ({"steps": 21}, "problem.steps 20 -> 21"),
        ({"limit": 0.8}, '"always (x < 0.9)" -> "always (x < 0.8)"'),
        ({"scale": 0.2}, "does not reproduce: robustness"),
    ],
)
def test_another_problem_is_refused(tmp_path, change, told):
    folder = tmp_path / "kept"
    with pytest.raises(systems.Killed):
        avrare.estimate(problem(50), rollouts=400, checkpoint=folder)
    with pytest.raises(avrare.UsageError) as caught:
        avrare.estimate(problem(**change), rollouts=400, checkpoint=folder)
    assert told in caught.value.message


def test_a_custom_proposal_is_identified_by_its_name(tmp_path):
    class Shifted:
        def sample(self, rng, n):
            return rng.standard_normal((n, 21, 1)) + 0.3

        def log_ratio(self, noise):
            return (0.045 - 0.3 * noise).sum(axis=(1, 2))

    call = {"proposal": Shifted(), "rollouts": 200}
    with pytest.raises(systems.Killed):
        avrare.estimate(problem(90), "is", checkpoint=tmp_path / "kept", **call)
    assert 'Shifted"' in (tmp_path / "kept" / "checkpoint.json").read_text()
    result = avrare.estimate(problem(), "is", checkpoint=tmp_path / "kept", **call)
    assert plain(result) == plain(avrare.estimate(problem(), "is", **call))


def test_rows_that_depend_on_their_neighbours_are_run_as_they_were(tmp_path):
    """Accept that one rollout alone differs where the chunk does not."""

    class Sociable(systems.Walk):
        def step(self, state, noise):
            return {"x": super().step(state, noise)["x"] + 1e-9 * len(noise)}

    def sociable(lives):
        system = systems.Mortal(Sociable(), lives)
        return avrare.Problem(system, avrare.stl("always (x < 0.9)"), steps=20, chunk=25)

    with pytest.raises(systems.Killed):
        avrare.estimate(sociable(50), rollouts=200, checkpoint=tmp_path / "kept")
    result = avrare.estimate(sociable(10**9), rollouts=200, checkpoint=tmp_path / "kept")
    assert plain(result) == plain(avrare.estimate(sociable(10**9), rollouts=200))


def test_the_step_that_differs_is_named(tmp_path):
    class Late(systems.Walk):
        def __init__(self, shift):
            super().__init__()
            self.shift = shift

        def initial(self, noise):
            return {"x": np.zeros(len(noise)), "t": np.zeros(len(noise))}

        def step(self, state, noise):
            late = self.shift * (state["t"] == 7)
            return {"x": self.move(state["x"], noise) + late, "t": state["t"] + 1}

    def late(shift):
        return avrare.Problem(Late(shift), avrare.stl("always (x < 0.9)"), steps=20, chunk=25)

    stop = iter([False, False, True])
    estimator = ImportanceSampling(IsConfig(rollouts=300, proposal={"name": "gaussian", "mean": 0.3}))
    journal = Checkpoint.open(tmp_path / "own", {}).journal("it")
    with pytest.raises(Interrupted):
        run(late(0.0), estimator, SerialExecutor(), Settings(), journal=journal, stop=lambda: next(stop))
    with pytest.raises(avrare.UsageError, match=r"does not reproduce: from step (8|9|1\d) on"):
        run(late(1.0), estimator, SerialExecutor(), Settings(), journal=journal)


def test_the_clock_continues_after_an_interruption(tmp_path, monkeypatch):
    """Count the time before the interruption in a budget of seconds and in the result."""
    now = [0.0]

    def estimate(stop=None):
        journal = Checkpoint.open(tmp_path, {}).journal("it")

        def tick(info):
            now[0] += 0.5

        settings = Settings(budget=Budget("seconds", 8.0))
        monkeypatch.setattr(loop.time, "perf_counter", lambda: now[0])
        estimator = MonteCarlo(McConfig())
        return run(problem(chunk=64), estimator, SerialExecutor(), settings, tick, journal, stop)

    stop = iter([False] * 3 + [True])
    with pytest.raises(Interrupted):
        estimate(lambda: next(stop))
    before, now[0] = now[0], 1000.0
    (result,) = estimate()
    assert before < 4.0
    assert 8.0 <= result.seconds < 12.0
    assert result.rollouts > 3 * 64


def test_a_folder_with_other_files_is_not_touched(tmp_path):
    (tmp_path / "precious.txt").write_text("mine")
    with pytest.raises(avrare.UsageError, match="is not empty and not a checkpoint"):
        avrare.estimate(problem(), rollouts=10, checkpoint=tmp_path)
    folder = tmp_path / "kept"
    with pytest.raises(systems.Killed):
        avrare.estimate(problem(50), rollouts=400, checkpoint=folder)
    (folder / "specification" / "notes").mkdir()
    (folder / "specification" / "notes" / "precious.npz").write_text("mine")
    avrare.estimate(problem(), rollouts=400, checkpoint=folder)
    left = [path.name for path in tmp_path.rglob("*") if path.is_file()]
    assert sorted(left) == ["precious.npz", "precious.txt"]
