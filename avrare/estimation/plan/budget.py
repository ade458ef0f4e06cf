"""Budget: upper bound on the cost of an estimate."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from avrare.base.errors import UsageError, did_you_mean

KINDS = ("steps", "rollouts", "seconds")


@dataclass(frozen=True)
class Budget:
    """An upper bound on cost; a run that has started may finish beyond it.

    Attributes:
        kind: Unit of the amount: "steps" (simulated steps), "rollouts" or "seconds".
        amount: Amount in that unit, positive and at most 1e15.

    Raises:
        UsageError: The kind or the amount is invalid.
    """

    kind: str
    amount: float

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise UsageError(f"unknown budget {self.kind!r}", did_you_mean(str(self.kind), KINDS))
        largest = 1e15  # more than a century of simulation
        if not (isinstance(self.amount, (int, float)) and 0.0 < self.amount <= largest):
            expectation = f"a positive number up to {largest:g}"
            hint = f"for example {self.kind}=1000"
            raise UsageError(f"budget {self.kind} must be {expectation}, not {self.amount!r}", hint)

    @staticmethod
    def parse(value: Budget | Mapping[str, float] | str | None) -> Budget | None:
        """Convert "steps=1e6", {"steps": 1e6} or a ``Budget`` to a budget; None stays None."""
        if value is None or isinstance(value, Budget):
            return value
        if isinstance(value, str):
            kind, equals, text = value.partition("=")
            pairs: Mapping[str, object] = {kind.strip(): text.strip().replace("_", "")} if equals else {}
        else:
            pairs = dict(value) if isinstance(value, Mapping) else {}
        if len(pairs) != 1:
            raise UsageError(
                f"budget {value!r} is not understood", "write steps=1e6, rollouts=1000 or seconds=60"
            )
        kind, amount = next(iter(pairs.items()))
        try:
            return Budget(kind, float(amount))  # type: ignore[arg-type]
        except (TypeError, ValueError):
            return Budget(kind, amount)  # type: ignore[arg-type]
