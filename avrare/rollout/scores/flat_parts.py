"""Flat parts of a formula: their robustness shows nothing before they fail, so that no score leads there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from avrare.logic.formula import Formula
from avrare.logic.semantics.normal_form import normalise
from avrare.logic.syntax import nodes
from avrare.logic.syntax.printer import to_text
from avrare.protocols import Floats, System
from avrare.rollout.request import Request
from avrare.rollout.scores.term_sizes import PROBE_ROWS, ScaledMonitor, Select, record


def find_flat_parts(
    system: System,
    steps: int,
    formula: Formula,
    select: Select | None = None,
    guide: ScaledMonitor | None = None,
    *,
    by_sample: bool = False,
    failures: Floats | None = None,
) -> tuple[str, ...]:
    """Return the parts of a formula, each of which must hold, that are flat in 64 rollouts.

    A part is flat if all the rollouts that keep it, at least half of them, keep it by the same robustness,
    and no known failure breaks it. The rollouts are those of ``measure_terms``, and no part of any estimate.

    Args:
        system: The system.
        steps: Last step of a rollout.
        formula: The formula.
        select: Function that makes the formula's signals of the system's.
        guide: The formula with its terms in parts of their sizes, where that is the score.
        by_sample: The score compares the robustness at each sample: a flat part has one at every sample.
        failures: Tapes (F, steps + 1, noise_size) of known failures.
    """
    rows = np.arange(PROBE_ROWS)
    signals = record(system, steps, formula.signals, Request.from_start(np.zeros_like(rows), rows), select)
    if not signals:
        return ()
    judge, signals = (
        (guide.formula, signals | guide.repeat_sizes(PROBE_ROWS)) if guide else (formula, signals)
    )
    parts = split_requirements(normalise(formula.node))
    judged = split_requirements(normalise(judge.node))
    flat = [
        part
        for part, scored in zip(parts, judged, strict=True)
        if nodes.signals(part) and is_flat(replace(judge, derived=scored), signals, by_sample)
    ]
    if flat and failures is not None and len(failures):
        replayed = record(system, steps, formula.signals, Request.replay(failures), select) or signals
        flat = [part for part in flat if replace(formula, derived=part).robustness(replayed).min() >= 0.0]
    return tuple(map(to_text, flat))


def split_requirements(node: nodes.Node) -> list[nodes.Node]:
    """Split a normalised formula into parts that it needs one and all."""
    match node:
        case nodes.Connective("and", left, right):
            return [*split_requirements(left), *split_requirements(right)]
        case nodes.Window("always" | "historically") | nodes.Quantifier(op="forall"):
            return [replace(node, child=part) for part in split_requirements(node.child)]
    return [node]


def is_flat(part: Formula, signals: dict[str, Floats], by_sample: bool) -> bool:
    """Return whether the rollouts that keep a part do so by the same robustness."""
    whole = part.robustness(signals)
    passing = whole[:, 0] >= 0.0
    if by_sample and isinstance(part.node, nodes.Window) and part.node.op == "always":
        whole = replace(part, derived=part.node.child).robustness(signals)
    seen = whole[passing] if by_sample else whole[passing, :1]
    return len(seen) >= PROBE_ROWS // 2 and bool((seen == seen[0]).all())
