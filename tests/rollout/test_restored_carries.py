"""Carries that were not kept are driven to again, to the same bits."""

from dataclasses import replace

import numpy as np
import pytest

import avrare
import odd_systems
from avrare.base import batch
from avrare.rollout.noise import NoiseSource
from avrare.rollout.request import Past, Request
from avrare.testing import faulty_systems as systems

STEPS, ROWS = 12, 9
NOISE = NoiseSource(3, 1)
FORMULAS = ["always (x < 0.4)", "eventually[2:5] (x > 0.1)", "always (x < 0.2 or once[0:3] (x < 0))"]
START = np.array([0, 0, 2, 5, 5, 5, 7, 11, 12])


def problem(formula, system=None):
    return avrare.Problem(system or odd_systems.Odometer(), avrare.stl(formula), steps=STEPS)


def branched(task, missing, origins=()):
    """Return rows that leave their parents at ``START``: with a past for ``missing``, carries for the others.

    ``origins`` maps some of the missing to a step before their start whose carry is at hand.
    """
    parents = Request.from_start(np.zeros(ROWS, np.int64), np.arange(ROWS), keep_carries=True)
    history = {t: carry for t, _, carry in task.simulate(NOISE, parents).carries}
    missing, origins = np.array(missing, dtype=np.int64), dict(origins)
    kept = np.setdiff1d(np.arange(ROWS), missing)
    carries = tuple((int(t), batch.take(history[t], kept[START[kept] == t])) for t in np.unique(START[kept]))
    origin = np.array([origins.get(row, -1) for row in missing], dtype=np.int64)
    known = tuple(
        (int(t), np.flatnonzero(origin == t), batch.take(history[t], missing[origin == t]))
        for t in np.unique(origin[origin >= 0])
    )
    tables = [np.broadcast_to(np.int32(0), (ROWS, STEPS + 1)), np.repeat(np.arange(ROWS), STEPS + 1)]
    stage, particle = tables[0][missing], tables[1].reshape(ROWS, -1)[missing].astype(np.int32)
    past = Past(missing, origin, stage, particle, 100 + missing, known)
    ones = np.ones(ROWS, dtype=np.int64)
    return Request(0 * ones, ones, np.arange(ROWS), START, carries, keep_carries=True, past=past)


def assert_same(one, two):
    for name in ("robustness", "violated", "error", "scores", "log_weight"):
        assert getattr(one, name).tobytes() == getattr(two, name).tobytes(), name
    assert one.counts.keys() == two.counts.keys()
    for name in one.counts:
        np.testing.assert_array_equal(one.counts[name], two.counts[name])


CASES = [
    (range(ROWS), {}), ([0], {}), ([8], {}), ([1, 4, 5, 7], {}), ([2, 3, 4, 6, 8], {3: 4, 4: 2, 8: 4}),
    (range(ROWS), {0: 0, 2: 2, 3: 4, 5: 4, 8: 8}),
]  # fmt: skip


@pytest.mark.parametrize("formula", FORMULAS)
@pytest.mark.parametrize(("missing", "origins"), CASES)
def test_the_same_bits_as_with_the_carries(formula, missing, origins):
    task = problem(formula)
    whole = task.simulate(NOISE, replace(branched(task, []), past=None))
    again = task.simulate(NOISE, branched(task, list(missing), origins))
    assert_same(again, whole)
    assert again.simulated_steps == whole.simulated_steps + sum(100 + row for row in missing)


def test_a_replay_that_does_not_repeat_is_reported():
    """Replay on a system that breaks down where the first one did not."""
    task = problem(FORMULAS[0], systems.Walk())
    request = branched(task, [4, 5])
    broken = problem(FORMULAS[0], systems.Fragile("nan", beyond=-9.0))
    with pytest.raises(avrare.UsageError, match="does not depend on its noise alone"):
        broken.simulate(NOISE, request)
