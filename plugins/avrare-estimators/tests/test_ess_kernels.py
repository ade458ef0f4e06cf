"""Each kernel alone: valid ones leave a set's law as it is, and no chain depends on its neighbours."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from studies.stationarity import drift, exact_starts, rolled_out

from avrare.base import batch
from avrare.rollout.noise import NoiseSource
from avrare.testing.problems import conjunction, four_branch, linear, walk
from avrare_estimators.common.chains.kernel import Draw
from avrare_estimators.common.chains.pcn import PcnKernel
from avrare_estimators.ess.kernels.elimination import free_angle
from avrare_estimators.ess.kernels.lipschitz import LipschitzKernel, _largest_singular_value
from avrare_estimators.ess.kernels.shrink import ShrinkKernel
from avrare_estimators.ess.kernels.stl_ess import BayesianKernel, GrowingLipschitzKernel

REGIONS = {"two_corners": conjunction(-1.2), "half_space": linear(1.5, 20), "four_branch": four_branch(4.0)}
MANY = 6000


def kernels(size):
    return {
        "shrink": (ShrinkKernel(), ()),
        "bracket": (ShrinkKernel(2.0), ()),
        "pcn": (PcnKernel(), np.array([0.7])),
        "lipschitz": (LipschitzKernel(1.0), ()),
        "growing": (GrowingLipschitzKernel(0.3), np.array([0.3])),
        "bayesian": (BayesianKernel(), ()),
    }


@lru_cache(maxsize=3)
def starts(region):
    return exact_starts(REGIONS[region].problem(), 0.0, MANY, seed=5)


def drifted(region, kernel, tuning):
    return drift(REGIONS[region].problem(), kernel, tuning, starts(region), 0.0, 10)


@pytest.mark.parametrize(
    ("region", "name"),
    [
        (region, name)
        for name in ("shrink", "bracket", "pcn", "lipschitz")
        for region in REGIONS
        if (region, name) != ("four_branch", "lipschitz")  # the slope of this score has no bound
    ],
)
def test_valid_kernels_leave_the_law_as_it_is(region, name):
    kernel, tuning = kernels(REGIONS[region].system.noise_size)[name]
    found = drifted(region, kernel, tuning)
    assert found.outside == 0.0
    assert max(abs(found.mean), abs(found.square)) < 3.5, found
    assert found.accepted > 0.1, "it hardly moves: too weak a test"
    assert not kernel.note


@pytest.mark.slow
@pytest.mark.parametrize("region", REGIONS)
def test_growing_slope_is_detected(region):
    found = drifted(region, *kernels(2)["growing"])
    assert found.mean > 5.0, found


class FreshAngles(ShrinkKernel):
    """Shrinks towards the first proposal instead of the chain's own tape."""

    def tell(self, move, found):
        move = super().tell(move, found)
        rows, old = move.waiting, move.work
        angle = old.angle.copy()
        angle[rows] = np.abs(angle[rows])
        proposal = np.cos(angle[rows])[:, None, None] * move.state.tape[rows]
        proposal += np.sin(angle[rows])[:, None, None] * old.other[rows]
        return replace(move, work=replace(old, angle=angle), proposal=proposal)


@pytest.mark.slow
def test_a_mutant_is_detected():
    assert abs(drifted("two_corners", FreshAngles(), ()).mean) > 3.5


def test_slopes_are_between_a_chain_and_its_proposals():
    """Fit the score u -> 3 x: no two tapes are farther apart than 3 per unit of length, some nearly so."""
    tape = np.random.default_rng(1).normal(size=(500, 1, 1))
    state = replace(rolled_out(linear(1.5, 1).problem(), tape), score=3.0 * tape[:, 0, 0])
    draw = Draw(NoiseSource(0, 1), 0, np.zeros(500, dtype=np.int64), 1, np.arange(500))
    for bound, steep in ((3.0, 0), (2.9, 500)):
        kernel = LipschitzKernel(bound)
        move = kernel.start((), state, np.full(500, 9.0), draw)
        found = replace(state, tape=move.proposal, score=3.0 * move.proposal[:, 0, 0])
        slopes = kernel.tell(move, found).work.slopes
        assert (int(slopes.pairs.sum()), int(slopes.steep.sum())) == (500, steep)
        np.testing.assert_allclose(slopes.most, 3.0, rtol=1e-6)


def test_a_broken_rollout_has_no_slope():
    state = rolled_out(linear(1.5, 1).problem(), np.ones((1, 1, 1)))
    draw = Draw(NoiseSource(0, 1), 0, np.zeros(1, dtype=np.int64), 1, np.zeros(1, dtype=np.int64))
    move = LipschitzKernel(1e-9).start((), state, np.full(1, 9.0), draw)
    found = replace(state, tape=move.proposal, score=np.full(1, -np.inf))
    slopes = LipschitzKernel(1e-9).tell(move, found).work.slopes
    assert (slopes.pairs.tolist(), slopes.steep.tolist(), slopes.most.tolist()) == ([0], [0], [0.0])


def test_broken_rollouts_are_never_taken():
    problem = walk(1.0, 5).problem()
    tape = np.zeros((3, 6, 1))
    for name, (kernel, tuning) in kernels(6).items():
        draw = Draw(NoiseSource(0, 1), 5, np.zeros(3, dtype=np.int64), 1, np.arange(3))
        zeros = np.zeros(3, dtype=np.int64)
        state = rolled_out(problem, tape)
        move = kernel.start(batch.take(tuning, zeros), state, np.full(3, -1.5), draw)
        while len(move.waiting):
            broken = rolled_out(problem, move.proposal)
            broken = replace(broken, score=np.full(len(broken.score), -np.inf))
            move = kernel.tell(move, broken)
        assert np.array_equal(move.state.tape, tape), name
        assert not move.accepted.any(), name


def test_free_angle_is_uniform_outside_the_arcs():
    rng = np.random.default_rng(3)
    many, circle = 20_000, 2.0 * np.pi
    center, half = rng.uniform(0.0, circle, size=(1, 5)), rng.uniform(0.0, 0.7, size=(1, 5))
    center, half = np.repeat(center, many, axis=0), np.repeat(half, many, axis=0)
    angle, empty = free_angle(center, half, (np.arange(many) + 0.5) / many)
    assert not empty.any()
    away = np.abs(np.mod(angle[:, None] - center + np.pi, circle) - np.pi)
    assert (away >= half - 1e-9).all(), "in an arc"
    grid = np.linspace(0.0, circle, 20_001)[:-1]
    free = (np.abs(np.mod(grid[:, None] - center[0] + np.pi, circle) - np.pi) > half[0]).all(axis=1)
    for low in np.linspace(0.0, circle, 9)[:-1]:
        inside = ((angle >= low) & (angle < low + circle / 8)).mean()
        expected = (free & (grid >= low) & (grid < low + circle / 8)).sum() / free.sum()
        assert abs(inside - expected) < 2e-3, low


def test_free_angle_says_when_nothing_is_left():
    centers, halves = np.tile([0.0, np.pi], (2, 1)), np.array([[2.0, 2.0], [1.0, 1.0]])
    assert free_angle(centers, halves, np.full(2, 0.5))[1].tolist() == [True, False]
    angle, empty = free_angle(np.zeros((1, 0)), np.zeros((1, 0)), np.array([0.25]))
    assert not empty[0]
    assert angle[0] == pytest.approx(np.pi / 2)


def test_largest_singular_value_bounds_how_fast_the_tape_moves():
    rng = np.random.default_rng(4)
    a, b = rng.normal(size=(2, 50, 3, 2))
    angle = np.linspace(0.0, 2.0 * np.pi, 721)[:, None, None, None]
    speed = np.sqrt(((np.cos(angle) * b - np.sin(angle) * a) ** 2).sum(axis=(2, 3))).max(axis=0)
    np.testing.assert_allclose(_largest_singular_value(a, b), speed, rtol=1e-4)
