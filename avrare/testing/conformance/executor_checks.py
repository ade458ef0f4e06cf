"""Executor checks: an ordered map over chunks."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from typing import Any

import numpy as np

from avrare.base.errors import AvrareError
from avrare.rollout.executors.serial import SerialExecutor
from avrare.rollout.executors.work import Executor, Work, run_on_worker
from avrare.rollout.noise import NoiseSource
from avrare.rollout.problem import Problem
from avrare.rollout.request import Request
from avrare.testing.conformance.suite import Subject
from avrare.testing.problems import walk

_CHUNKS, _ROWS = 12, 5


def outcomes_are_those_of_serial(subject: Subject) -> None:
    """Every chunk has the outcome of the serial executor, in the order of the chunks."""
    wanted = _outcomes(SerialExecutor())
    outcomes = _outcomes(subject.build())
    assert len(outcomes) == len(wanted), f"{len(outcomes)} outcomes of {len(wanted)} chunks"
    for index, (expected, outcome) in enumerate(zip(wanted, outcomes, strict=True)):
        for name in ("robustness", "violated", "error"):
            same = np.array_equal(
                getattr(expected, name), getattr(outcome, name), equal_nan=name == "robustness"
            )
            assert same, f"{name} of chunk {index} differs"


def runs_functions_on_workers(subject: Subject) -> None:
    """A function call returns the value of the function for the problem, or raises its error."""
    executor = subject.build()
    executor.open(_work())
    with closing(executor):
        assert run_on_worker(executor, "a check", _add, 2) == _work().problem.steps + 2, "another answer"
        try:
            run_on_worker(executor, "a check", _add, None)
        except TypeError:
            return
        raise AssertionError("a function call that raises gives an answer")


def runs_more_than_once(subject: Subject) -> None:
    """It can be opened again after it was closed."""
    executor = subject.build()
    first, second = _outcomes(executor), _outcomes(executor)
    assert len(first) == len(second) == _CHUNKS, "some outcomes are missing the second time"


def takes_chunks_as_there_is_room(subject: Subject) -> None:
    """It does not read all chunks before it gives the first outcome."""
    executor, taken = subject.build(), []

    def chunks() -> Iterator[Request]:
        for chunk in _chunks(200):
            taken.append(chunk)
            yield chunk

    executor.open(_work())
    with closing(executor):
        next(iter(executor.map(chunks())))
        assert len(taken) < 200, "all 200 chunks were read before the first outcome"


def errors_come_through(subject: Subject) -> None:
    """An error of the work ends the map with that error."""
    executor = subject.build()
    executor.open(_work())
    with closing(executor):
        try:
            list(executor.map([Request.replay(np.zeros((2, 3, 9)))]))
        except (AvrareError, ValueError, IndexError, TypeError):
            return
        raise AssertionError("a chunk that cannot be run gave an outcome instead of an error")


def _add(problem: Problem, number: Any) -> int:
    return problem.steps + int(number)


def _outcomes(executor: Executor) -> list[Any]:
    executor.open(_work())
    with closing(executor):
        return list(executor.map(_chunks(_CHUNKS)))


def _work() -> Work:
    problem = walk(1.0, 20).problem(chunk=_ROWS)
    return Work(problem, NoiseSource(1, problem.noise_size), scored=False)


def _chunks(number: int) -> list[Request]:
    rows = np.arange(number * _ROWS)
    request = Request.from_start(np.zeros_like(rows), rows)
    return [request.slice(at, at + _ROWS) for at in range(0, len(rows), _ROWS)]


CHECKS = (
    outcomes_are_those_of_serial,
    runs_functions_on_workers,
    runs_more_than_once,
    takes_chunks_as_there_is_room,
    errors_come_through,
)
