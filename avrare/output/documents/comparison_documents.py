"""Content of comparison.json (estimators on one problem) and paired.json (two versions on the same noise)."""

from __future__ import annotations

from dataclasses import asdict

from avrare.analysis.compare.comparison import ArmResult, Comparison
from avrare.analysis.compare.paired_comparison import PairedComparison
from avrare.analysis.compare.repetition_statistics import Summary, find_disagreements
from avrare.analysis.compare.version_changes import VersionChange
from avrare.base import version
from avrare.estimation.result.result import finite
from avrare.scenario.fingerprint import fingerprint

_REPETITION_FIELDS = (
    "probability", "interval", "relative_error", "rollouts", "simulated_steps", "failures", "errors",
    "health", "seconds",
)  # fmt: skip
"""Fields of the entries of a repetition's result."""


def comparison_document(comparison: Comparison) -> dict[str, object]:
    """Return all numbers of a comparison, JSON-ready; NaN and infinities become null."""
    case, design, truth = comparison.case, comparison.design, comparison.truth
    summaries = comparison.summaries
    used = {
        result.arm.distribution: result.arm.version for result in comparison.arms if result.arm.distribution
    }
    content = {
        "schema": 1,
        "comparison": case.name,
        "specification": case.specification or None,
        "fingerprint": case.fingerprint,
        "versions": dict(sorted({**case.versions, **used, "avrare": version.__version__}.items())),
        "steps": case.problem.steps,
        "budget": {design.budget.kind: design.budget.amount},
        "repeat": design.repeat,
        "seed": design.seed,
        "confidence": case.confidence,
        "truth": asdict(truth) if truth else None,
        "interrupted": comparison.interrupted,
        "disagree": find_disagreements([result.arm.label for result in comparison.arms], summaries),
        "estimators": [
            _encode_arm(arm, summary, design.seed)
            for arm, summary in zip(comparison.arms, summaries, strict=True)
        ],
    }
    return finite(content)


def _encode_arm(result: ArmResult, summary: Summary | None, seed: int) -> dict[str, object]:
    entries = [repetition.to_dict() for repetition in result.repetitions]
    return {
        "label": result.arm.label,
        "estimator": result.arm.name,
        "options": result.arm.config.model_dump(mode="json"),
        "refusal": result.refusal.message if result.refusal else None,
        "summary": asdict(summary) if summary else None,
        "repetitions": [
            {"seed": seed + k} | {name: entry[name] for name in _REPETITION_FIELDS}
            for k, entry in enumerate(entries)
        ],
    }


def paired_document(paired: PairedComparison) -> dict[str, object]:
    """Return all numbers of a paired comparison, JSON-ready."""
    versions = {name: number for scenario in paired.scenarios for name, number in scenario.versions.items()}
    content = {
        "schema": 1,
        "first": paired.names[0],
        "second": paired.names[1],
        "fingerprints": [fingerprint(scenario) for scenario in paired.scenarios],
        "versions": dict(sorted({**versions, "avrare": version.__version__}.items())),
        "rollouts": paired.rollouts,
        "seed": paired.seed,
        "confidence": paired.confidence,
        "specifications": [_encode_change(change, paired.confidence) for change in paired.changes],
    }
    return finite(content)


def _encode_change(change: VersionChange, confidence: float) -> dict[str, object]:
    return {
        "specification": change.specification,
        "probability": [change.first, change.second],
        "difference": change.difference,
        "interval": change.interval(confidence),
        "ratio": change.ratio,
        "ratio_interval": change.ratio_interval(confidence),
        "highest": change.highest(confidence),
        **change.document(),
        "verdict": change.verdict(confidence),
    }
