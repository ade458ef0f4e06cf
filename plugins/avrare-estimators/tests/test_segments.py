"""Rollouts in segments: a tape drawn under a law goes on where it stopped, and features come with it."""

import warnings
from dataclasses import replace

import numpy as np
import pytest

import avrare
from avrare.rollout.noise import NoiseSource
from avrare.rollout.request import Past, Request, Rollouts
from avrare.rollout.tape_source import draw_lineage
from avrare.testing.problems import reference_problem
from avrare_estimators.common.tapes.tape_mixture import NONE, TapeMixture
from avrare_estimators.smc.defended_mixture import DefendedMixture

STEPS, AT = 40, 12
NOISE = NoiseSource(3, 1)
SHIFT = {(0, 5, 30, 1.0, 0.0, 3.0, 1.0): 0.5, (0, 5, 30, 1.0, 0.2, -3.0, 1.5): 0.5}
OUTLIER = {(0, t, t, 1.0, 0.0, 0.0, 2.5): 0.25 for t in (3, 10, 20, 30)}
MIXTURE = TapeMixture.freeze([(0.6, [SHIFT]), (0.4, [OUTLIER])], (STEPS + 1, 1))
LAW = DefendedMixture(MIXTURE, 0.25)


def walk():
    problem = reference_problem("d_rw_L3.8").problem()
    return avrare.Problem(problem.system, avrare.stl("always (x < 1.2)"), STEPS)


def fresh(rows, **fields):
    zeros = np.zeros(rows, dtype=np.int64)
    return Request(zeros, zeros, np.arange(rows), zeros - 1, tape_law=LAW, **fields)


def second(first, **fields):
    """Return the request that continues rows which stopped at ``AT``."""
    alive = np.flatnonzero(~first.violated[:, 0] & ~first.error)
    ((t, rows, carry),) = first.carries
    assert t == AT
    assert np.array_equal(rows, alive)
    zeros = np.zeros(len(alive), dtype=np.int64)
    return alive, Request(
        zeros,
        zeros + 1,
        alive,
        zeros + AT,
        ((AT, carry),),
        tape_law=LAW,
        evidence=first.evidence[alive],
        stop_failed=True,
        **fields,
    )


def segment(problem, rows):
    return problem.simulate(NOISE, fresh(rows, until=AT, observe=(AT,), stop_failed=True, keep_carries=True))


def addresses(rows):
    stage = np.where(np.arange(STEPS + 1) <= AT, 0, 1)
    return (
        np.zeros((rows, 1), np.int64),
        np.tile(stage, (rows, 1)),
        np.tile(np.arange(rows)[:, None], STEPS + 1),
    )


def test_a_continued_tape_has_the_law_of_a_whole_one():
    problem, rows = walk(), 20_000
    whole = problem.simulate(NOISE, fresh(rows))
    expected = np.exp(whole.log_weight) * whole.violated[:, 0]
    first = segment(problem, rows)
    alive, request = second(first)
    rest = problem.simulate(NOISE, request)
    found = np.where(first.violated[:, 0], np.exp(first.log_weight), 0.0)
    found[alive] = np.exp(rest.log_weight) * rest.violated[:, 0]
    spread = np.sqrt((found.var() + expected.var()) / rows)
    assert found.mean() > 20 * spread
    assert abs(found.mean() - expected.mean()) < 4 * spread
    # The same law without weights: as many rows fail, and the weights of all add up to their number.
    ends = np.concatenate([first.violated[:, 0][~np.isin(np.arange(rows), alive)], rest.violated[:, 0]])
    assert abs(ends.mean() - whole.violated.mean()) < 4 * np.sqrt(2 * 0.25 / rows)
    assert abs(np.exp(rest.log_weight).mean() - np.exp(first.log_weight[alive]).mean()) < 0.05


def test_a_lineage_is_drawn_again():
    problem = walk()
    first = segment(problem, 200)
    alive, request = second(first)
    rest = problem.simulate(NOISE, request)
    run, stage, particle = addresses(200)
    tapes = draw_lineage(NOISE, LAW, run, stage, particle)[alive]
    again = problem.simulate(NOISE, replace(Request.replay(tapes), tape_law=LAW))
    going = ~rest.violated[:, 0]
    assert 10 < going.sum() < len(alive) - 10
    assert np.array_equal(again.robustness[going], rest.robustness[going])
    assert np.array_equal(again.log_weight[going], rest.log_weight[going])
    assert np.array_equal(again.violated, rest.violated)


def test_carries_are_rebuilt_under_the_law():
    problem = walk()
    first = segment(problem, 60)
    alive, request = second(first)
    _, stage, particle = (a[alive] for a in addresses(60))
    zeros = np.zeros(len(alive), np.int64)
    past = Past(np.arange(len(alive)), zeros - 1, stage, particle, zeros)
    rebuilt = problem.simulate(NOISE, replace(request, carries=(), past=past))
    kept = problem.simulate(NOISE, request)
    for name in ("robustness", "violated", "log_weight"):
        assert np.array_equal(getattr(rebuilt, name), getattr(kept, name))


@pytest.mark.parametrize("size", [1, 7])
def test_segments_do_not_depend_on_the_chunk(size):
    problem = walk()
    first = segment(problem, 40)
    _, request = second(first, until=30, observe=(20, 30))
    whole = problem.simulate(NOISE, request)
    parts = [problem.simulate(NOISE, request.slice(k, k + size)) for k in range(0, request.rows, size)]
    joined = Rollouts.join(parts)
    for name in ("features", "evidence", "log_weight", "violated", "robustness"):
        assert np.array_equal(getattr(joined, name), getattr(whole, name), equal_nan=name == "features")
    assert np.isnan(whole.features[whole.violated[:, 0]][:, -1]).all()


def test_features_of_a_plain_system_are_its_signals_and_the_monitor():
    first = segment(walk(), 30)
    alive = ~first.violated[:, 0]
    found = first.features[alive, 0]
    assert found.shape[1] == 4  # x, margin, robustness, score
    assert np.allclose(found[:, 1], 1.2 - found[:, 0])
    assert (found[:, 2] <= found[:, 1]).all()
    assert np.allclose(found[:, 3], -found[:, 2])
    assert not first.violated[alive].any()
    assert first.evidence.shape[1] == MIXTURE.terms


def test_a_row_that_is_surely_of_the_target_is_chosen_without_a_warning():
    single = TapeMixture.freeze([(1.0, [{(0, 5, 30, 1.0, 0.0, 3.0, 1.0): 1.0}])], (STEPS + 1, 1))
    law = DefendedMixture(single, 0.25)
    sums = np.tile([-400.0, STEPS + 1.0], (3, 1))  # far on the other side
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        chosen = law.choose(np.array([[u, 0.5, 0.5] for u in (0.0, 0.5, 1.0 - 2.0**-53)]), sums)
    assert (chosen["atom"] == NONE).all()
