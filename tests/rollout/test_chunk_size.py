"""Chunks that nobody names: their size comes from a row, its steps and the workers; results do not see it."""

from dataclasses import dataclass, field

import numpy as np
import pytest

import avrare
from avrare.base.errors import Interrupted
from avrare.estimation.loop.checkpoint import Checkpoint
from avrare.estimation.loop.loop import run
from avrare.estimation.monte_carlo.config import McConfig
from avrare.estimation.monte_carlo.monte_carlo import MonteCarlo
from avrare.estimation.plan.plan import Settings
from avrare.rollout.executors.serial import SerialExecutor
from avrare.rollout.request import LEAST, MOST, WORLD_ROWS, Request, spread
from avrare.testing import faulty_systems as systems
from avrare.worlds import as_system
from estimates import plain


class Wide(systems.Walk):
    """A walk whose rows take many bytes."""

    def __init__(self, numbers):
        super().__init__()
        self.numbers = numbers

    def initial(self, noise):
        return super().initial(noise) | {"ballast": np.zeros((len(noise), self.numbers))}

    def step(self, state, noise):
        return super().step(state, noise) | {"ballast": state["ballast"]}

    def signals(self, state):
        return {"x": state["x"]}


@dataclass
class Crew(SerialExecutor):
    """Says that it has workers, and remembers what it was given."""

    workers: int
    rows: list = field(default_factory=list)

    def map(self, chunks):
        for chunk in chunks:
            if isinstance(chunk, Request):
                self.rows.append(chunk.rows)
            yield self._work.run(chunk)


def problem(system=None, steps=10, chunk=None):
    return avrare.Problem(system or systems.Walk(), avrare.stl("always (x < 1)"), steps, chunk=chunk)


def test_it_follows_the_memory_of_a_row_and_the_steps():
    assert problem().chunk == MOST
    assert problem(chunk=7).chunk == 7
    one, half = problem(Wide(500)).chunk, problem(Wide(1000)).chunk
    assert LEAST < half < one < MOST
    assert half == pytest.approx(0.5 * one, rel=0.05)
    assert problem(Wide(10**6)).chunk == LEAST
    assert problem(steps=1000).chunk == 131
    assert problem(steps=10**6).chunk == LEAST


def test_a_system_that_breaks_at_the_start_is_reported_by_the_rollouts():
    broken = problem(systems.Fragile("raise", -9.0, at_start=True))
    assert broken.chunk == MOST


def test_worlds_come_in_small_chunks():
    class Still:
        noise_size = 1

        def reset(self, noise):
            pass

        def step(self, action, noise):
            pass

        def signals(self):
            return {"x": 0.0}

    assert problem(as_system(Still)).chunk == WORLD_ROWS


@pytest.mark.parametrize("rows", [1, 2, 24, 250, 251, 1000, 4097])
@pytest.mark.parametrize("workers", [1, 2, 7])
def test_pieces_are_no_larger_than_a_chunk_and_give_every_worker_as_much(rows, workers):
    size = spread(rows, 250, workers)
    pieces = [min(size, rows - at) for at in range(0, rows, size)]
    assert sum(pieces) == rows
    assert max(pieces) <= 250
    share = -(-rows // workers)
    busiest = max(sum(pieces[w::workers]) for w in range(workers))
    assert busiest <= share + len(pieces)


def test_rollouts_are_spread_over_the_workers_and_results_are_the_same():
    results, crews = [], [Crew(1), Crew(3)]
    for crew in crews:
        [result] = run(problem(), MonteCarlo(McConfig(rollouts=1000)), crew, Settings(seed=2))
        results.append(plain(result))
    assert crews[0].rows == [1000]
    assert crews[1].rows == [334, 334, 332]
    assert results[0] == results[1] == plain(avrare.estimate(problem(chunk=9), rollouts=1000, seed=2))


def test_another_number_of_workers_resumes(tmp_path):
    estimator, looks = MonteCarlo(McConfig(rollouts=20_000)), iter([False, False, True])
    task = {"task": "same"}
    journal = Checkpoint.open(tmp_path / "kept", task).journal("x")
    with pytest.raises(Interrupted):
        run(problem(), estimator, Crew(2), Settings(), journal=journal, stop=lambda: next(looks, True))
    crew = Crew(3)
    journal = Checkpoint.open(tmp_path / "kept", task).journal("x")
    [resumed] = run(problem(), estimator, crew, Settings(), journal=journal)
    assert 0 < sum(crew.rows) < 20_000
    [whole] = run(problem(), estimator, SerialExecutor(), Settings())
    assert plain(resumed) == plain(whole)
