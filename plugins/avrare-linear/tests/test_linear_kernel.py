"""The exact kernel keeps the law of a level's set, whatever the score; the estimator is unbiased."""

import numpy as np
import pytest

import avrare
from avrare.base import batch
from avrare.rollout.noise import NoiseSource
from avrare.rollout.request import Request
from avrare.testing.problems import conjunction, linear, reach, reference_problem, walk
from avrare.testing.repeated_estimates import deviation, standard_error
from avrare_estimators.common.chains.kernel import Draw, Points
from avrare_linear.kernel import ExactKernel, WholeTrace, to_solvable
from plain_systems import LogProduct, Still


class Ramp(Still):
    """x rises by 1 a step; margins of the noise-free run differ from step to step."""

    def initial(self, noise):
        return {"x": 0.5 * noise[:, 0], "t": np.zeros(len(noise))}

    def step(self, state, noise):
        return {"x": state["x"] + 1.0 + 0.5 * noise[:, 0], "t": state["t"] + 1.0}


def ramp(score):
    return avrare.Problem(Ramp(), avrare.stl("always (x < 2 * t + 1.5)"), 6, score)


def two(text):
    return avrare.Problem(Ramp(), avrare.stl(text), 6)


PROBLEMS = {
    "a": (conjunction(-1.2).problem(), 0.5),
    "a, level": (conjunction(-2.0).problem(), -1.0),
    "b": (linear(1.5, 20).problem(), 0.0),
    "d, level": (walk(2.5).problem(), -1.0),
    "i": (avrare.Problem(LogProduct(5), avrare.stl("log_product < 1.6"), 0), 0.0),
    "g, whole trace": (to_solvable(reach(1.0).problem()), -1.5),
    "margin": (ramp("margin"), 0.5),
    "sizes": (two("always (x < 2 * t + 1.5 and not (100 * abs(x) > 700 + 200 * t))"), -0.6),
    "sizes, whole trace": (to_solvable(two("(always x < 2 * t + 1.5) and eventually (100 * x > 650)")), -0.3),
}


def points(problem, tape):
    rollouts = problem.simulate(NoiseSource(0, problem.noise_size), Request.replay(tape))
    return Points.of(tape, rollouts, np.arange(len(tape)))


def start(problem, level, many, seed=5):
    """Draw exactly from the law of a level's set."""
    chains = np.arange(many)[:, None]
    tape = NoiseSource(seed, problem.noise_size).normals(0, 0, chains, np.arange(problem.steps + 1))
    found = points(problem, tape)
    return batch.take(found, np.flatnonzero(found.above(np.full(many, level)))[:4000])


def step(kernel, problem, state, level, stage, seed=6):
    chains = np.arange(len(state.tape))
    source = NoiseSource(seed, problem.noise_size)
    draw = Draw(source, problem.steps, np.zeros_like(chains), stage, chains)
    move = kernel.start((), state, np.full(len(chains), level), draw)
    assert len(move.waiting) == len(chains)  # one rollout each
    done = kernel.tell(move, points(problem, move.proposal))
    assert not len(done.waiting)
    assert done.accepted.mean() > 0.999  # only rounding can lose one
    return done.state


@pytest.mark.slow
@pytest.mark.parametrize("name", PROBLEMS)
def test_the_kernel_leaves_the_target_invariant(name):
    problem, level = PROBLEMS[name]
    kernel = ExactKernel.of(problem, moves=2)
    before = start(problem, level, 100_000 if problem.steps == 0 else 12_000)
    assert len(before.tape) > 500
    state = before
    for stage in range(5):
        state = step(kernel, problem, state, level, stage)
    assert state.above(np.full(len(state.score), level)).all()

    def measure(points):
        return (points.tape**2).sum(axis=(1, 2)), points.robustness, points.tape[:, -1, 0]

    for change in np.array(measure(state)) - np.array(measure(before)):
        assert abs(change.mean()) < 3.5 * change.std() / np.sqrt(len(change))


def test_chains_mix_between_separate_regions():
    problem, level = conjunction(-2.0).problem(), -1.0
    state = start(problem, level, 20_000)
    side = np.sign(state.tape[:, 0, 0])
    for stage in range(3):
        state = step(ExactKernel.of(problem), problem, state, level, stage)
    moved = np.mean(np.sign(state.tape[:, 0, 0]) != side)
    assert moved > 0.1


@pytest.mark.parametrize("name", ["a, level", "g, whole trace", "margin", "sizes", "sizes, whole trace"])
def test_segments_agree_with_the_engine(name):
    problem, level = PROBLEMS[name]
    kernel = ExactKernel.of(problem)
    chains = np.arange(8)[:, None]
    source = NoiseSource(1, problem.noise_size)
    tape, other = (source.normals(0, stage, chains, np.arange(problem.steps + 1)) for stage in (0, 1))
    angles = np.linspace(0.0, 2.0 * np.pi, 1000, endpoint=False) + 1e-5
    levels = np.full(8, level)
    inside = kernel.slicer.segments(tape, other, kernel.threshold(levels)).contains(np.tile(angles, (8, 1)))
    cosine, sine = np.cos(angles)[:, None, None], np.sin(angles)[:, None, None]
    tapes = (tape[:, None] * cosine + other[:, None] * sine).reshape(-1, *tape.shape[1:])
    expected = points(problem, tapes).above(np.full(len(tapes), level)).reshape(8, -1)
    assert 0.01 < expected.mean() < 0.99
    assert (inside == expected).all()


def test_scores_without_a_closed_form_are_replaced_or_refused():
    problem = reach(1.0).problem()
    with pytest.raises(avrare.UsageError, match="score of specification"):
        ExactKernel.of(problem)
    assert isinstance(to_solvable(problem).score, WholeTrace)
    for score in ("robustness", "margin"):
        assert to_solvable(ramp(score)).score == score
    with pytest.raises(avrare.UsageError, match="is not given as stl"):
        to_solvable(avrare.Problem(Ramp(), _NoFormula(), 3))


class _NoFormula:
    def start(self, n):
        return None

    def update(self, state, signals):
        raise NotImplementedError


@pytest.mark.slow
@pytest.mark.parametrize("name", ["a_beta_-2", "b_linear_d100_p1e-4", "g_eventually_c1.0"])
def test_the_estimator_is_unbiased(name):
    problem = reference_problem(name)
    found = avrare.estimate(problem.problem(), "ess_linear", seed=4, chains=50, runs=25)
    assert abs(deviation(found.run_probabilities, problem.probability)) < 4.0
    assert standard_error(found.run_probabilities) < 0.25 * problem.probability
    assert found.diagnostics["kernel"] == "exact"


def test_runs_do_not_depend_on_how_many_there_are():
    problem = conjunction(-2.0).problem()
    few, many = (avrare.estimate(problem, "ess_linear", seed=9, chains=20, runs=runs) for runs in (2, 5))
    assert few.run_probabilities.tolist() == many.run_probabilities[:2].tolist()
