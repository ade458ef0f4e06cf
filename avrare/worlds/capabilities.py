"""Capabilities of systems, checked before an estimator that needs them runs.

| capability | needed by |
|---|---|
| ``branches`` | splitting: a rollout continues from the state of another one |
| ``noise`` | every method that draws the noise from another distribution, changes it or stores it |
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

from avrare.base.errors import UsageError
from avrare.protocols import System, adapt
from avrare.worlds.determinism import STEPS, Findings, probe

_WANTS = {"branches": "continue rollouts from others", "noise": "choose the noise of a rollout"}


@dataclass(frozen=True)
class Capabilities:
    """Capabilities of a system.

    Attributes:
        branches: A rollout can continue from the state of another one.
        noise: The same noise gives the same rollout.
        reason: Reason why a capability is missing; empty where none is.
    """

    branches: bool
    noise: bool
    reason: str = ""


def capabilities(system: object, steps: int = STEPS) -> Capabilities:
    """Return the capabilities of ``system``, as its simulator declares (``lacks``) and as ``probe`` finds."""
    system = adapt(System, system)
    lacks = system.lacks or {}
    if "noise" not in lacks:
        findings = probe(system, steps)
        lacks = {**{name: text for name, text in _limits(findings).items() if text}, **lacks}
    reason = next(iter(lacks.values()), "")
    return Capabilities("branches" not in lacks, "noise" not in lacks, reason)


def refuse_limits(estimator: str, lacks: Mapping[str, str], needs: Collection[str]) -> None:
    """Raise a ``UsageError`` if an estimator of this name needs a missing capability."""
    missing = [need for need in needs if lacks.get(need)]
    if missing:
        hint = "return new arrays from `step`, and derive every random choice from its noise"
        raise UsageError(
            f"{estimator} must {' and '.join(_WANTS[need] for need in missing)}, which this system does not "
            f"allow: {lacks[missing[0]]}",
            f"{hint}; estimator: {{plugin: mc}} needs neither",
        )


def require(system: System, estimator: str, needs: Collection[str], steps: int = STEPS) -> dict[str, str]:
    """Refuse a system that lacks a capability that an estimator needs: "branches", "noise".

    "noise" is required of simulators that declare ``lacks``; of any other system a warning is enough.

    Returns:
        Reasons of the health warnings to give, by name: ``not_deterministic``, ``rounding``.
    """
    lacks = system.lacks or {}
    refuse_limits(estimator, lacks, needs)
    if "noise" in lacks:
        return {"not_deterministic": lacks["noise"]}
    findings = probe(system, steps, branch="branches" in needs)
    refuse_limits(estimator, _limits(findings), set(needs) - {"noise"} if system.lacks is None else needs)
    reasons = {"not_deterministic": findings.differs, "rounding": findings.rounding}
    return {name: reason for name, reason in reasons.items() if reason}


def _limits(findings: Findings) -> dict[str, str]:
    return {"noise": findings.differs, "branches": findings.in_place or findings.differs or findings.branches}
