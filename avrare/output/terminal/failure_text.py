"""Text about shrunk failures for the terminal."""

from __future__ import annotations

from avrare.analysis.failures.shrink import ShrinkResult
from avrare.rollout.noise_words import describe_tape
from avrare.rollout.problem import Problem

MAX_BLOB = 1000
"""Longest blob [characters] that is printed; for longer ones the command that prints them is shown."""


def describe_shrinking(problem: Problem, shrunk: ShrinkResult) -> list[str]:
    """Describe the rest of a failure in numbers and words."""
    if shrunk.after == 0.0:
        description = describe_tape(problem, shrunk.noise)
        lines = [f"it fails without any noise ({shrunk.rollouts} rollouts): {description}"]
        if shrunk.passing_noise is not None:
            lines.append(f"it passes with: {describe_tape(problem, shrunk.passing_noise)}")
        return lines
    lines = [
        f"shrunk to {shrunk.ratio:.1%} of its norm ({shrunk.before:.3g} -> {shrunk.after:.3g}), "
        f"{shrunk.nonzero} of {shrunk.noise.size} numbers ({shrunk.rollouts} rollouts)",
        f"the rest: {describe_tape(problem, shrunk.noise)}",
    ]
    return lines if shrunk.reason is None else [*lines, f"more than a tenth is left: {shrunk.reason}"]
