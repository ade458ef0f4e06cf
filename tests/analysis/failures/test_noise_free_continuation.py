"""Moments from which on drives are lost, on a body that keeps its speed where no more noise follows."""

from dataclasses import dataclass

import numpy as np
import pytest

import avrare
from avrare.analysis.failures.noise_free_continuation import Continuations, continue_without_noise
from avrare.cli.main import main
from pushed_point import pushed_point

LIMIT = 3.0


@dataclass(frozen=True)
class Body:
    """Point whose speed the noise changes."""

    x: np.ndarray
    v: np.ndarray


class Coasting:
    """Speed is a random walk; without noise the point coasts."""

    noise_size = 1

    def initial(self, noise):
        return Body(np.zeros(len(noise)), 0.1 * noise[:, 0])

    def step(self, state, noise):
        v = state.v + 0.1 * noise[:, 0]
        return Body(state.x + v, v)

    def signals(self, state):
        return {"x": state.x}


def problem(steps):
    return avrare.Problem(Coasting(), avrare.stl(f"always (x < {LIMIT})"), steps=steps)


def lost_by_hand(tape):
    """Return first step from which coasting fails, where it fails at the last step."""
    steps = len(tape) - 1
    v = 0.1 * np.cumsum(tape[:, 0])
    x = np.cumsum(v) - v[0]  # the first row only sets the speed
    kept = [k for k in range(-1, steps + 1) if not _fails(x, v, k, steps)]
    return kept[-1] + 1


def _fails(x, v, end, steps):
    if end < 0:
        return False
    return max(*x[: end + 1], x[end], x[end] + v[end] * (steps - end)) >= LIMIT


@pytest.mark.parametrize("steps", [12, 400])
def test_the_last_moment_is_found(steps):
    rng = np.random.default_rng(3)
    found = problem(steps)
    tapes = [rng.normal(size=(steps + 1, 1)) for _ in range(60)]
    failing = [tape for tape in tapes if found.robustness(tape[None])[0] < 0.0]
    assert len(failing) > 5
    early = 0
    for tape in failing:
        done = continue_without_noise(found, tape)
        if steps == 12:
            assert done.lost == lost_by_hand(tape)
        else:  # every fourth step at first
            assert done.lost <= lost_by_hand(tape)
            ends = [np.where(np.arange(steps + 1)[:, None] < done.lost + k, tape, 0.0) for k in (0, 1)]
            kept, violated = found.robustness(np.stack(ends))
            assert kept > 0.0 > violated
        assert done.rollouts == len(done.steps) <= 130
        early += done.steps[done.violated][0] < steps
    assert early == len(failing)


def test_a_drive_that_is_kept_is_not_lost():
    done = continue_without_noise(problem(5), np.zeros((6, 1)))
    assert done.lost is None
    assert done.describe() == "it is not lost: the rule is kept"


def test_it_is_said_in_words():
    tape = np.zeros((11, 1))
    tape[4] = 6.0  # 0.6 a step: 3.0 after five of them
    done = continue_without_noise(problem(10), tape)
    assert done.lost == 4
    text = "lost at step 4: with noise only until step 3 the rule is kept; it is violated 4 steps later"
    assert done.describe(8) == text


def test_a_system_that_fails_without_noise_says_so():
    done = continue_without_noise(
        avrare.Problem(Coasting(), avrare.stl("always (x < 0)"), steps=4), np.ones((5, 1))
    )
    assert done.lost is None
    assert done.describe() == "it fails without any noise"


@pytest.mark.parametrize(
    ("robustness", "words"),
    [
        ((np.nan, -1.0, -1.0), "when it was lost is not known: the rollouts with less noise broke down"),
        ((-1.0, np.nan, -1.0), "it fails without any noise"),
        ((np.nan, np.nan, np.nan), "when it was lost is not known: the rollouts with less noise broke down"),
        ((-1.0, -1.0, 1.0), "it is not lost: the rule is kept"),
    ],
)
def test_rollouts_that_break_down_are_not_kept(robustness, words):
    values = np.array(robustness)
    done = Continuations(np.arange(-1, 2), values, values < 0.0, None, 3)
    assert done.lost is None
    assert done.describe() == words


def test_an_infinite_margin_is_kept():
    values = np.array([np.inf, np.inf, -1.0])
    done = Continuations(np.arange(-1, 2), values, values < 0.0, None, 3)
    assert done.lost == 1


def test_replay_says_when_it_was_lost(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "plane.yaml").write_text(pushed_point(1.0, rollouts=200))
    assert main(["run", "plane.yaml", "--out", "run", "--no-pictures"]) == 0
    capsys.readouterr()
    assert main(["replay", "--run", "run", "--lost"]) == 0
    assert "lost at t = " in capsys.readouterr().out
    assert main(["why", "run", "--budget", "rollouts=300"]) == 4
    assert "--budget requires --shrink" in capsys.readouterr().err
    assert main(["why", "run", "--shrink", "--budget", "rollouts=300", "--fresh", "0", "--out", "run"]) == 0
    said = capsys.readouterr().out
    assert "needs only: " in said
    assert "lost at t = " in said
    assert main(["report", "run"]) == 0
