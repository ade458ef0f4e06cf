"""Text about failures for the terminal: replays, shrunk failures and searches."""

from __future__ import annotations

from avrare.analysis.failures.noise_description import describe
from avrare.analysis.failures.shrink import ShrinkResult
from avrare.analysis.failures.stored_replays import FailureReplay
from avrare.rollout.problem import Problem

MAX_BLOB = 1000
"""Longest blob [characters] that is printed; for longer ones the command that prints them is shown."""


def describe_replay(replay: FailureReplay) -> list[str]:
    """Return the outcome of a replay, and what has changed."""
    failure, rollout = replay.failure, replay.rollout
    robustness = f"robustness {rollout.robustness:.6g}"
    outcomes = {
        "fails": f"failure {failure.id} is reproduced: {failure.specification} is violated, {robustness}",
        "passes": f"failure {failure.id} does not fail now: {failure.specification} holds, {robustness}",
        "error": f"failure {failure.id} ends with an error: {rollout.error}",
    }
    outcome = outcomes[rollout.outcome]
    if replay.divergence is None:
        compared = "the signals are" if len(failure.checksums) else "the robustness is"
        return [outcome, f"{compared} bit-identical", *replay.changes]
    unchanged = ("scenario and versions are the same: the machine or the code differs",)
    return [outcome, replay.divergence, *(replay.changes or unchanged)]


def describe_shrinking(problem: Problem, shrunk: ShrinkResult) -> list[str]:
    """Return what is left of a failure, in numbers and in words."""
    if shrunk.after == 0.0:
        description = describe(problem, shrunk.noise)
        lines = [f"it fails without any noise ({shrunk.rollouts} rollouts): {description}"]
        if shrunk.passing_noise is not None:
            lines.append(f"it passes with: {describe(problem, shrunk.passing_noise)}")
        return lines
    lines = [
        f"shrunk to {shrunk.ratio:.1%} of its norm ({shrunk.before:.3g} -> {shrunk.after:.3g}), "
        f"{shrunk.nonzero} of {shrunk.noise.size} numbers ({shrunk.rollouts} rollouts)",
        f"what is left: {describe(problem, shrunk.noise)}",
    ]
    return lines if shrunk.reason is None else [*lines, f"more than a tenth is left: {shrunk.reason}"]
