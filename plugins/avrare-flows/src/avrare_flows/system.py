"""Systems over physical noise as systems over standard normal numbers."""

from __future__ import annotations

from typing import Any

from avrare.errors import UsageError
from avrare.protocols import Floats, Signals, System
from avrare_flows.laws import Law


class TransformedSystem:
    """An ``avrare.protocols.System``, see ``transformed``.

    Attributes:
        system: Over physical noise.
        law: Of its noise.
        first: Of row 0, the noise of the start.
        noise_size: Of either.
        notes: Health warnings that every result of it must carry.
    """

    def __init__(self, system: System, law: Law, first: Law) -> None:
        self.system, self.law, self.first = system, law, first
        self.noise_size = system.noise_size
        self.notes = notes_of(law, first)
        for name in ("faults", "counts"):
            if hasattr(system, name):
                setattr(self, name, getattr(system, name))

    def initial(self, noise: Floats) -> Any:
        """The state at t = 0 from standard normal rows (N, noise_size)."""
        return self.system.initial(self.first.physical(noise))

    def step(self, state: Any, noise: Floats) -> Any:
        """The state one step later."""
        return self.system.step(state, self.law.physical(noise))

    def signals(self, state: Any) -> Signals:
        """The system's."""
        return self.system.signals(state)


def transformed(system: System, law: Law, *, initial: Law | None = None) -> TransformedSystem:
    """A system that reads physical noise, for estimators that hand out standard normal numbers.

    With an exact law (``avrare_flows.laws.Joint``) nothing is left to correct: the failure probability
    is that of the physical noise, under every estimator and without weights.

    Args:
        system: Its ``initial`` and ``step`` take physical noise (N, noise_size).
        law: Of the noise, independent from row to row.
        initial: Of row 0, where it has another law.

    Raises:
        UsageError: A law has another number of columns than the system's noise.
    """
    for one in (law, initial or law):
        check_size(one, system.noise_size)
    return TransformedSystem(system, law, initial or law)


def notes_of(*laws: Law) -> dict[str, str]:
    """Health warnings on laws that are not exact."""
    found = [law.note for law in laws if law.note]
    return {"model_error": found[0]} if found else {}


def check_size(law: Law, size: int) -> None:
    """Whether a law has ``size`` numbers a row.

    Raises:
        UsageError: It has not.
    """
    if law.noise_size != size:
        raise UsageError(
            f"the law has {law.noise_size} numbers a row, but the system's noise has {size}",
            "give one law for each number of a row",
        )
