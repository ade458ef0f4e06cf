"""A comparison as plain data: the content of comparison.json."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import avrare
from avrare.compare.study import Comparison, Entry
from avrare.compare.summary import Summary, disagreements, summarise
from avrare.estimation.result import finite

SCHEMA = 1


def summaries(comparison: Comparison) -> list[Summary | None]:
    """The statistics of each estimator; None for one that was refused."""
    case = comparison.case
    return [
        None
        if entry.refusal
        else summarise(entry.repetitions, comparison.truth, case.problem.steps, case.confidence)
        for entry in comparison.entries
    ]


def document(comparison: Comparison) -> dict[str, Any]:
    """All numbers of a comparison, JSON-ready; NaN and infinities become null."""
    case, design, truth = comparison.case, comparison.design, comparison.truth
    used = {
        entry.arm.distribution: entry.arm.version for entry in comparison.entries if entry.arm.distribution
    }
    content = {
        "schema": SCHEMA,
        "comparison": case.name,
        "specification": case.specification or None,
        "fingerprint": case.fingerprint,
        "versions": dict(sorted({**case.versions, **used, "avrare": avrare.__version__}.items())),
        "steps": case.problem.steps,
        "budget": {design.budget.kind: design.budget.amount},
        "repeat": design.repeat,
        "seed": design.seed,
        "confidence": case.confidence,
        "truth": asdict(truth) if truth else None,
        "interrupted": comparison.interrupted,
        "disagree": disagreements([entry.arm.label for entry in comparison.entries], summaries(comparison)),
        "estimators": [
            _entry(entry, summary)
            for entry, summary in zip(comparison.entries, summaries(comparison), strict=True)
        ],
    }
    return finite(content)  # type: ignore[no-any-return]


def _entry(entry: Entry, summary: Summary | None) -> dict[str, Any]:
    return {
        "label": entry.arm.label,
        "estimator": entry.arm.name,
        "options": entry.arm.config.model_dump(mode="json"),
        "refusal": str(entry.refusal) if entry.refusal else None,
        "summary": asdict(summary) if summary else None,
        "repetitions": [{**asdict(one), "seconds": round(one.seconds, 3)} for one in entry.repetitions],
    }
