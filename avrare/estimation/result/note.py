"""Notes of an estimate: sentences that every table, page and notebook shows in the same words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from pydantic import ConfigDict, with_config

from avrare.base.number_format import format_narrow


@with_config(ConfigDict(strict=False))  # strict models read it from JSON
@dataclass(frozen=True)
class Note:
    """Complete sentence about an estimate, other than a health warning.

    Attributes:
        kind: Its subject, in one word (docs/python.md lists those in use); any estimator may add its own.
        text: The sentence.
    """

    kind: str
    text: str


def describe_missed_goal(rollouts: int, progress: str, option: str = "rollouts") -> Note:
    """Return the note on an estimate that ended short of its goal.

    Args:
        rollouts: Number of its rollouts.
        progress: Result that it reached, for instance "with 3 failures".
        option: Option of the estimator that bounds its cost.
    """
    text = (
        f"The run ended after {rollouts:,} rollouts, {progress}, before it reached its goal: "
        f"raise `{option}` of the estimator, or the budget."
    )
    return Note("goal", text)


def describe_precision(probability: float, relative_error: float) -> str:
    """Return the progress of an estimate whose goal is a relative error."""
    return f"at a relative error of {relative_error:.0%}" if probability else "without reaching a failure"


def describe_stop(used: int, failures: int) -> Note:
    """Return the note on an estimate that rests on the first ``used`` rollouts, where more were simulated."""
    counted = f"{used:,} rollouts, of which {failures:,} failed"
    text = f"The goal was reached after {counted}: the others do not count."
    return Note("goal", text)


def describe_blind_bound(bound: float | None) -> tuple[Note, ...]:
    """Return the note on a ``Result.blind_bound``; none without a bound."""
    if bound is None:
        return ()
    text = f"Failures that the score does not lead to could be as likely as {format_narrow(bound)}."
    return (Note("blind", text),)


def describe_errors(errors: int, rollouts: int, messages: Sequence[str]) -> tuple[Note, ...]:
    """Return the note on rollouts that ended in an error; empty without errors."""
    if not errors:
        return ()
    text = (
        f"An error ended {errors:,} of {rollouts:,} rollouts, which count as failures in the upper end; "
        f"the first: {messages[0] if messages else 'no reason given'} "
        "(`avrare replay --run DIR --error 0` repeats it)."
    )
    return (Note("errors", text),)


def list_error_notes(notes: Sequence[Note]) -> list[str]:
    """Return the texts on errors."""
    return [note.text for note in notes if note.kind == "errors"]


def describe_counts(counts: Mapping[str, int]) -> tuple[Note, ...]:
    """Return the notes on the counters of a system that are not 0: those of its solver, and the others."""
    nonzero = {name: count for name, count in counts.items() if count and name != "solves"}
    total = f" of {counts['solves']:,} solves" if "solves" in counts else ""
    notes = []
    for of_solver in (True, False):
        texts = [
            f"{name.replace('_', ' ')} {count:,}"
            for name, count in nonzero.items()
            if ("solve" in name) == of_solver
        ]
        if texts:
            notes.append(Note("counts", f"Counted: {', '.join(texts)}{total * of_solver}."))
    return tuple(notes)
