"""What a simulator can do beyond being run: asked before anything runs for an estimator that needs it.

| need | who needs it |
|---|---|
| ``branches`` | splitting: a rollout goes on from where another one was |
| ``noise`` | everything that draws the noise from another law, moves it or stores it |
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from avrare.errors import UsageError
from avrare.protocols import System

_TRIED = 3
"""Steps of the trial."""


@dataclass(frozen=True)
class Capabilities:
    """What a system can do.

    Attributes:
        branches: A rollout can go on from where another one was.
        noise: The same noise gives the same rollout.
        reason: Why not, empty where it can do everything.
    """

    branches: bool
    noise: bool
    reason: str = ""


def capabilities(system: System, steps: int = _TRIED) -> Capabilities:
    """What ``system`` can do: what it says of itself (``lacks``), and what two runs on the same noise show.

    Args:
        system: Any system; its simulator may have ``lacks``, a mapping of needs to reasons.
        steps: Steps of the trial, 4 rollouts of them.
    """
    lacks = dict(getattr(_simulator(system), "lacks", {}))
    if "noise" not in lacks:
        try:
            reason = _difference(system, steps)
        except UsageError:
            raise
        except Exception:  # a rollout that breaks down is counted where it is run, and says nothing here
            reason = ""
        if reason:
            lacks = {"noise": reason, "branches": reason} | lacks
    reason = next(iter(lacks.values()), "")
    return Capabilities("branches" not in lacks, "noise" not in lacks, reason)


def require(system: System, estimator: str, needs: Iterable[str]) -> None:
    """Refuse a system that cannot do what an estimator needs.

    Only simulators with ``lacks`` are asked: the others know nothing but values.

    Args:
        system: Any system.
        estimator: Its name.
        needs: "branches", "noise".

    Raises:
        UsageError: Saying what it cannot do and why.
    """
    wanted = list(needs)
    if not wanted or not hasattr(_simulator(system), "lacks"):
        return
    can = capabilities(system)
    missing = [need for need in wanted if not getattr(can, need)]
    if missing:
        what = {"branches": "start rollouts from others", "noise": "choose the noise of a rollout"}
        raise UsageError(
            f"{estimator} must {' and '.join(what[need] for need in missing)}, which this simulator does not "
            f"allow: {can.reason}",
            "estimator: {plugin: mc} needs nothing of it",
        )


def _simulator(system: Any) -> Any:
    """The part that has worlds: of a closed loop, of worlds with a controller, or the system itself."""
    return getattr(system, "simulator", None) or getattr(system, "worlds", system)


def _difference(system: System, steps: int) -> str:
    """Where two runs on the same noise differ, empty where they do not."""
    # Any numbers do, if they are not round ones.
    noise = np.sin(np.arange(1.0, 2.0 * (steps + 1) * system.noise_size + 1.0)).reshape(2, steps + 1, -1)
    first, again = _run(system, noise), _run(system, noise)
    for t, (one, two) in enumerate(zip(first, again, strict=True)):
        for name in one:
            if not np.array_equal(one[name], two[name], equal_nan=one[name].dtype.kind == "f"):
                return f"signal {name!r} differs at step {t} between two runs on the same noise"
    return ""


def _run(system: System, noise: Any) -> list[dict[str, Any]]:
    state = system.initial(np.ascontiguousarray(noise[:, 0]))
    found = [dict(system.signals(state))]
    for t in range(1, noise.shape[1]):
        state = system.step(state, np.ascontiguousarray(noise[:, t]))
        found.append(dict(system.signals(state)))
    return found
