"""What an estimate may cost."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from avrare.errors import UsageError, did_you_mean

KINDS = ("steps", "rollouts", "seconds")


@dataclass(frozen=True)
class Budget:
    """An upper bound on cost; a run that has started may finish beyond it.

    Attributes:
        kind: "steps" (simulated steps), "rollouts" or "seconds".
        amount: Positive.
    """

    kind: str
    amount: float

    @staticmethod
    def parse(value: Budget | Mapping[str, float] | str | None) -> Budget | None:
        """A budget from "steps=1e6", {"steps": 1e6}, or one already made.

        Raises:
            UsageError: Not one of those.
        """
        if value is None or isinstance(value, Budget):
            return value
        if isinstance(value, str):
            kind, _, text = value.partition("=")
            pairs: Mapping[str, object] = {kind.strip(): text.strip().replace("_", "")}
        else:
            pairs = dict(value) if isinstance(value, Mapping) else {}
        if len(pairs) != 1:
            raise UsageError(
                f"budget {value!r} is not understood", "write steps=1e6, rollouts=1000 or seconds=60"
            )
        kind, amount = next(iter(pairs.items()))
        if kind not in KINDS:
            raise UsageError(f"unknown budget {kind!r}", did_you_mean(kind, KINDS))
        try:
            number = float(amount)  # type: ignore[arg-type]
        except (TypeError, ValueError):
            number = float("nan")
        if not 0.0 < number < float("inf"):
            raise UsageError(f"budget {kind} must be a positive number, not {amount!r}")
        return Budget(kind, number)
