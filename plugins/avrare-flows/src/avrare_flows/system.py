"""Systems over physical noise as systems over standard normal numbers."""

from __future__ import annotations

from typing import Any

from avrare.base.errors import UsageError
from avrare.protocols import Floats, System, SystemWrapper, adapt
from avrare_flows.laws import Law


class TransformedSystem(SystemWrapper):
    """System made by ``transformed``.

    Attributes:
        system: System over physical noise.
        law: Law of its noise.
        first: Law of row 0, the noise of the start.
        noise_size: Number of numbers of a row.
        warnings: Health warnings for every result.
    """

    def __init__(self, system: System, law: Law, first: Law) -> None:
        super().__init__(system)
        self.law, self.first = law, first
        self.warnings, self.perfect_noise = list_warnings(law, first), None

    def initial(self, noise: Floats) -> Any:
        """Return the state at t = 0 from standard normal rows (N, noise_size)."""
        return self.system.initial(self.first.physical(noise))

    def step(self, state: object, noise: Floats) -> Any:
        """Return the state one step later."""
        return self.system.step(state, self.law.physical(noise))


def transform_noise(system: object, law: Law, *, initial: Law | None = None) -> TransformedSystem:
    """Adapt a system that reads physical noise to standard normal noise tapes.

    With an exact law (``avrare_flows.laws.Joint``) nothing is left to correct: the failure probability
    is that of the physical noise, under every estimator and without weights.

    Args:
        system: System whose ``initial`` and ``step`` take physical noise (N, noise_size).
        law: Law of the noise, independent from row to row.
        initial: Law of row 0, where it differs.

    Raises:
        UsageError: A law has another number of columns than the system's noise.
    """
    physical = adapt(System, system)
    for columns in (law, initial or law):
        check_size(columns, physical.noise_size)
    return TransformedSystem(physical, law, initial or law)


def list_warnings(*laws: Law) -> dict[str, str]:
    """Return the health warning of laws that are not exact."""
    notes = [law.note for law in laws if law.note]
    return {"model_error": notes[0]} if notes else {}


def check_size(law: Law, size: int) -> None:
    """Check that a law has ``size`` numbers a row.

    Raises:
        UsageError: It has another number.
    """
    if law.noise_size != size:
        raise UsageError(
            f"the law has {law.noise_size} numbers a row, but the system's noise has {size}",
            "give one law for each number of a row",
        )
