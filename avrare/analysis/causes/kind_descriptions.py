"""Decisive noise of each kind's most typical failure, in words, and when the drive was lost."""

from __future__ import annotations

from dataclasses import replace

from avrare.analysis.causes.first_violation import find_first_violation
from avrare.analysis.causes.kinds import Kind, Kinds
from avrare.analysis.failures.noise_free_continuation import continue_without_noise
from avrare.analysis.failures.shrink import BUDGET, shrink
from avrare.analysis.failures.tape_evaluator import ProgressCallback
from avrare.protocols import Floats
from avrare.rollout.noise_words import describe_tape
from avrare.rollout.problem import Problem
from avrare.rollout.replay import replay_tape


def describe_kinds(
    problem: Problem,
    kinds: Kinds,
    noise: Floats,
    budget: int = BUDGET,
    progress: ProgressCallback | None = None,
) -> Kinds:
    """Return the kinds with ``decisive`` and ``lost`` of their most typical failures.

    Args:
        problem: Problem of the specification.
        kinds: Kinds of the failures.
        noise: (F, steps + 1, noise_size) tapes of the failures.
        budget: Rollouts to shrink each of these failures.
        progress: Called after each chunk of rollouts.
    """
    described = tuple(_describe(problem, kind, noise, budget, progress) for kind in kinds.kinds)
    return replace(kinds, kinds=described)


def _describe(
    problem: Problem,
    kind: Kind,
    noise: Floats,
    budget: int,
    progress: ProgressCallback | None,
) -> Kind:
    tape = noise[kind.representative]
    small = shrink(problem, tape, budget, progress)
    decisive = "it fails without any noise" if small.after == 0.0 else describe_tape(problem, small.noise)
    first = find_first_violation(problem, replay_tape(problem, tape))
    lost = continue_without_noise(problem, tape).describe(first.sample if first.sample >= 0 else None)
    return replace(kind, decisive=decisive, lost=lost)
