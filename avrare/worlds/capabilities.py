"""Capabilities of simulators, checked before an estimator that needs them runs.

| capability | needed by |
|---|---|
| ``branches`` | splitting: a rollout continues from the state of another one |
| ``noise`` | every method that draws the noise from another distribution, changes it or stores it |
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from avrare.base.errors import UsageError
from avrare.protocols import HasLimits, System, find_ability, find_simulator


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


def capabilities(system: System, steps: int = 3) -> Capabilities:
    """Return the capabilities of ``system``, as declared (``lacks``) and as two runs on the same noise show.

    Args:
        system: Any system; its simulator may declare ``lacks``, reasons by missing capability.
        steps: Steps of the trial, which runs 4 rollouts.
    """
    limited = find_ability(find_simulator(system), HasLimits)
    lacks = dict(limited.lacks) if limited is not None else {}
    if "noise" not in lacks:
        try:
            reason = _difference(system, steps)
        except UsageError:
            raise
        except Exception:  # an error is counted where it occurs in an estimate
            reason = ""
        if reason:
            lacks = {"noise": reason, "branches": reason} | lacks
    reason = next(iter(lacks.values()), "")
    return Capabilities("branches" not in lacks, "noise" not in lacks, reason)


def require(system: System, estimator: str, needs: Iterable[str]) -> None:
    """Refuse a system that lacks what an estimator needs: "branches", "noise".

    Only simulators with ``lacks`` are tried: the state of any other is a value, which can be copied.
    """
    wanted = list(needs)
    if not wanted or find_ability(find_simulator(system), HasLimits) is None:
        return
    can = capabilities(system)
    missing = [need for need in wanted if not getattr(can, need)]
    if missing:
        what = {"branches": "continue rollouts from others", "noise": "choose the noise of a rollout"}
        raise UsageError(
            f"{estimator} must {' and '.join(what[need] for need in missing)}, which this simulator does not "
            f"allow: {can.reason}",
            "estimator: {plugin: mc} needs neither",
        )


def _difference(system: System, steps: int) -> str:
    # Any numbers will do that are not round.
    noise = np.sin(np.arange(1.0, 2.0 * (steps + 1) * system.noise_size + 1.0)).reshape(2, steps + 1, -1)
    first, second = list(_run(system, noise)), list(_run(system, noise))
    for t, (one, two) in enumerate(zip(first, second, strict=True)):
        for name in one:
            if not np.array_equal(one[name], two[name], equal_nan=one[name].dtype.kind == "f"):
                return f"signal {name!r} differs at step {t} between two runs on the same noise"
    return ""


def _run(system: System, noise: Any) -> Iterator[dict[str, Any]]:
    state: Any = None
    for t in range(noise.shape[1]):
        given = np.ascontiguousarray(noise[:, t])
        state = system.step(state, given) if t else system.initial(given)
        yield dict(system.signals(state))
