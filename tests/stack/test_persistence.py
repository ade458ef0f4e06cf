"""Errors that last in the closed loop: the memory travels with the particle, and every estimator agrees."""

import dataclasses
import functools
from dataclasses import dataclass

import numpy as np
import pytest

import avrare
import toy_closed_loop as toy
from avrare.base import batch
from avrare.driving import Observation
from avrare.rollout.noise import NoiseSource
from avrare.rollout.request import Request
from avrare.stack.closed_loop import ClosedLoop
from avrare_gp_pem.config import NaivePemConfig
from avrare_gp_pem.runtime.models import build_naive

STEPS, DT, TAU = 8, 0.1, 0.3
SCENE = dataclasses.replace(toy.scene(), dt=DT)


class Line(toy.Line):
    """Another vehicle stands 10 m ahead."""

    dt, noise_size = DT, 2


class LastError:
    """Keeps the error along the road of the last observation; a miss is none."""

    def start(self, world):
        return np.zeros(len(world.lost))

    def update(self, track, observation):
        return np.where(observation.detected, observation.x - 10.0, 0.0)[:, 0]

    def predict(self, track, steps):
        return track


@dataclass(frozen=True)
class Wandering:
    """Somebody else's model: errors add up, and it claims a density."""

    noise_size = 1

    def start(self, noise):
        return {"sum": noise.copy()}

    def observe(self, world, noise):
        x = world.others.x + noise
        return Observation(np.ones(x.shape, bool), x, world.others.y, world.others.speed)

    def follow(self, world, noise, memory):
        total = memory["sum"] + noise
        return self.observe(world, total), {"sum": total}

    def log_prob(self, world, observation):
        return np.zeros(len(world.lost))


def naive(position=TAU):
    config = NaivePemConfig(detection=1 - 1e-12, persistence={"position": position, "detection": position})
    return build_naive(config, SCENE)


def problem(perception, formula="always (lost < 9)", chunk=1024):
    loop = ClosedLoop(Line(SCENE), perception, LastError(), toy.Believes())
    return avrare.Problem(loop, avrare.stl(formula), STEPS, chunk=chunk)


def test_the_memory_starts_with_the_first_row_and_accumulates():
    task = problem(Wandering())
    tape = np.random.default_rng(0).standard_normal((5, STEPS + 1, 3))
    carries = task.replay(tape, keep_carries=True).carries
    heard = np.cumsum(tape[:, :, 2], axis=1)
    for t, _, carry in carries:
        np.testing.assert_allclose(carry.system.latent["sum"][:, 0], heard[:, t])
        np.testing.assert_allclose(carry.system.world.lost, heard[:, 1:t].sum(axis=1), atol=1e-12)


def test_without_persistence_nothing_is_remembered():
    task = problem(naive(position=0.0))
    carry = task.simulate(NoiseSource(1, task.noise_size), fresh(3, keep_carries=True)).carries[-1][2]
    assert carry.system.latent is None


def fresh(rows, **keywords):
    return Request.from_start(np.zeros(rows, np.int64), np.arange(rows), **keywords)


@pytest.mark.parametrize("perception", [naive(), Wandering()], ids=["naive", "wandering"])
@pytest.mark.parametrize("at", [0, 1, 5])
def test_a_branch_carries_the_memory_of_its_parent(perception, at):
    task = problem(perception, f"always[{STEPS}:{STEPS} samples] (lost < 9)")
    tape = np.random.default_rng(at).standard_normal((6, STEPS + 1, task.noise_size))
    source = NoiseSource(0, task.noise_size)
    parents = task.simulate(source, Request.replay(tape, keep_carries=True))
    carry = {t: carry for t, _, carry in parents.carries}[at]
    chosen = np.array([4, 1, 1])
    branched = tape[chosen]
    branched[:, at + 1 :] = np.random.default_rng(9).standard_normal(branched[:, at + 1 :].shape)
    zeros = np.zeros(3, np.int64)
    start = np.full(3, at)
    request = Request(zeros, zeros, zeros, start, ((at, batch.take(carry, chosen)),), tape=branched)
    whole = task.simulate(source, Request.replay(branched))
    ours = task.simulate(source, request)
    assert ours.robustness.tobytes() == whole.robustness.tobytes()
    assert len(np.unique(whole.robustness)) == 3
    # and it matters: the same noise behind another past is another course
    other = batch.take(carry, np.array([0, 2, 3]))
    forgotten = dataclasses.replace(
        batch.take(carry, chosen),
        system=dataclasses.replace(batch.take(carry.system, chosen), latent=other.system.latent),
    )
    request = dataclasses.replace(request, carries=((at, forgotten),))
    assert (task.simulate(source, request).robustness != whole.robustness).all()


def test_rows_of_the_loop_do_not_depend_on_their_neighbours():
    task = problem(naive())
    source = NoiseSource(3, task.noise_size)
    whole = task.simulate(source, fresh(40)).robustness
    for begin, end in ((0, 1), (7, 31), (39, 40)):
        part = task.simulate(source, fresh(40).slice(begin, end)).robustness
        assert part.tobytes() == whole[begin:end].tobytes()


@functools.cache
def reference(limit, samples=300_000):
    """Return P(a partial sum of the errors reaches the limit), from the covariance of the whole course."""
    at = np.arange(STEPS - 1)
    covariance = np.exp(-DT / TAU * abs(at[:, None] - at))
    normal = np.random.default_rng(7).standard_normal((samples, len(at)))
    sums = np.cumsum(normal @ np.linalg.cholesky(covariance).T, axis=1)
    return (sums.max(axis=1) >= limit).mean()


@pytest.mark.parametrize(
    ("estimator", "options"),
    [
        ("mc", {"rollouts": 8000}),
        ("ams", {"particles": 100, "discard": 10}),
        ("ess", {"chains": 100}),
        ("is", {"rollouts": 8000, "proposal": {"name": "gaussian", "std": 1.3}}),
    ],
)
def test_estimators_agree_with_the_exact_covariance(estimator, options):
    result = avrare.estimate(problem(naive()), estimator, seed=5, confidence=0.99, **options)
    exact = reference(9.0)
    assert 0.005 < exact < 0.05
    low, high = result.interval
    assert low < exact < high
    assert high < 2.5 * low
    assert result.probability == pytest.approx(exact, rel=0.25)


def is_by(target, proposal):
    return avrare.estimate(problem(target), "is", proposal=proposal, rollouts=50)


@pytest.mark.parametrize(
    ("target", "proposal"),
    [
        (naive(), naive(0.0)),
        (naive(), {"plugin": "naive"}),
        (naive(0.0), {"plugin": "naive", "persistence": {"speed": 0.2}}),
        (Wandering(), naive(0.0)),
        (naive(0.0), Wandering()),
    ],
)
def test_a_density_given_the_past_is_refused_before_anything_runs(target, proposal, monkeypatch):
    monkeypatch.setattr(Line, "reset", lambda self, noise: pytest.fail("something has run"))
    with pytest.raises(avrare.UsageError, match="last over steps") as caught:
        is_by(target, proposal)
    assert "gaussian" in caught.value.hint
