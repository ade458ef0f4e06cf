"""What a call of ``avrare.estimate`` is about, for its checkpoint."""

from __future__ import annotations

import dataclasses
import json
from typing import Any

import avrare
from avrare.estimation.loop import Settings
from avrare.estimation.plan import Estimator
from avrare.plugin.registry import default_registry
from avrare.rollout.problem import Problem


def described(problem: Problem, name: str, estimator: Estimator, settings: Settings) -> dict[str, Any]:
    """What must be equal for a checkpoint to be gone on with, as plain data.

    A system and a score have no name that says what they do: a stored rollout that is run again tells them.
    """
    row = default_registry().find("estimator", name)
    formula = getattr(problem.monitors[0], "formula", None)
    task = {
        "estimator": name,
        "options": getattr(getattr(estimator, "config", None), "model_dump", dict)(),
        "settings": dataclasses.asdict(settings),
        "problem": {
            "system": type(problem.system).__qualname__, "steps": problem.steps, "chunk": problem.chunk,
            "noise_size": problem.noise_size, "formula": getattr(formula, "text", None),
            "score": getattr(problem.score, "text", problem.score),
        },
        "versions": {"avrare": avrare.__version__, row.distribution: row.version},
    }  # fmt: skip
    return json.loads(json.dumps(task, default=_plain))  # type: ignore[no-any-return]


def _plain(value: Any) -> Any:
    """Arrays as lists, and of other objects the name of their class or their own."""
    if hasattr(value, "tolist"):
        return value.tolist()
    return getattr(value, "__qualname__", type(value).__qualname__)
