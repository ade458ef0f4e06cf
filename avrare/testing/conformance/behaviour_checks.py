"""Behaviour checks: parts of a closed loop and specifications on a batch of particles."""

from __future__ import annotations

import pickle
import random
from collections.abc import Callable

import numpy as np

from avrare.base import batch
from avrare.testing.conformance.exercises import Exercise, Outputs, read_only, split_and_join
from avrare.testing.conformance.suite import Subject


def outputs_are_rows(subject: Subject) -> None:
    """Every output is an array with one entry per particle."""
    exercise = Exercise(subject)
    for name, value in exercise.outputs.items():
        assert isinstance(value, np.ndarray), f"{name} is a {type(value).__name__}, not an array"
        shape, n = value.shape, exercise.rows
        assert shape[:1] == (n,), f"{name} has shape {shape} for {n} particles"


def same_noise_same_bits(subject: Subject) -> None:
    """The same noise gives the same bits, the second time and from a new part."""
    exercise, other = Exercise(subject), Exercise(subject)
    _compare(exercise.outputs, exercise.play(exercise.tape), "the second time")
    _compare(exercise.outputs, other.outputs, "from a new part")


def draws_no_numbers_of_its_own(subject: Subject) -> None:
    """The global random generators of Python and NumPy are not used."""
    before = _generators()
    Exercise(subject)
    assert before == _generators(), "it draws from a global generator; derive all choices from the noise"


def rows_are_independent(subject: Subject) -> None:
    """The outputs of a particle are the same, bit for bit, whatever the rest of the batch."""
    exercise = Exercise(subject)
    for rows in ([2], [5, 0], [6, 4, 3, 1]):
        outputs = exercise.play(exercise.tape[rows])
        _compare(batch.take(exercise.outputs, np.array(rows)), outputs, f"rows {rows} without the others")


def states_can_be_copied(subject: Subject) -> None:
    """Splitting and joining a state between steps changes no bit."""
    exercise = Exercise(subject)
    _compare(exercise.outputs, exercise.play(exercise.tape, split_and_join), "with copied states")


def states_are_values(subject: Subject) -> None:
    """A step does not modify the state that it starts from."""
    exercise = Exercise(subject)
    _compare(exercise.outputs, exercise.play(exercise.tape, read_only), "with read-only states")


def nan_stays_in_its_row(subject: Subject) -> None:
    """A NaN in one particle raises nothing and does not affect the others."""
    exercise = Exercise(subject)
    if exercise.tape.shape[2] == 0:
        return
    tape = exercise.tape.copy()
    tape[0, 1:] = np.nan
    with np.errstate(all="ignore"):
        outputs = exercise.play(tape)
    others = np.arange(1, exercise.rows)
    _compare(batch.take(exercise.outputs, others), batch.take(outputs, others), "beside a row of NaN")


def _generators() -> bytes:
    return pickle.dumps((random.getstate(), np.random.get_state()))


def _compare(wanted: Outputs, outputs: Outputs, when: str) -> None:
    assert list(wanted) == list(outputs), f"different outputs {when}: {sorted(set(wanted) ^ set(outputs))}"
    for name, value in wanted.items():
        equal = np.array_equal(value, outputs[name], equal_nan=value.dtype.kind == "f")
        assert equal, f"{name} differs {when}"


CHECKS: tuple[Callable[[Subject], None], ...] = (
    outputs_are_rows,
    same_noise_same_bits,
    draws_no_numbers_of_its_own,
    rows_are_independent,
    states_can_be_copied,
    states_are_values,
    nan_stays_in_its_row,
)
