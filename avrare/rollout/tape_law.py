"""Laws of noise tapes that a request may be drawn from, in place of independent standard normal numbers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from avrare.protocols import Floats

Integers = NDArray[np.int64]
CHOICES = 3
"""Uniform numbers that decide what a proposal changes in a tape."""


class TapeProposal(Protocol):
    """Proposal of complete noise tapes, a mixture, that is drawn and weighed step by step.

    Attributes:
        digest: Hexadecimal digits that identify it.
        terms: A, the number of sums over the steps that its density needs.
    """

    @property
    def digest(self) -> str: ...  # noqa: D102

    @property
    def terms(self) -> int: ...  # noqa: D102

    def choose(self, uniform: Floats, sums: Floats | None = None) -> NDArray[Any]:
        """Return the changes of rows (M, ...) with these uniform numbers (M, CHOICES) in (0, 1).

        With ``sums`` (M, A) of the steps so far it is drawn given these steps: the rest of the tape then has
        the proposal's law given its beginning.
        """

    def transform(self, noise: Floats, chosen: NDArray[Any], first: int) -> None:
        """Change standard normals (M, K, noise_size) of the steps from ``first`` on into the rows' law."""

    def evidence(self, noise: Floats, step: int) -> tuple[Integers, Floats]:
        """Return which of the A sums a step changes, (k,), and by how much, (k, M), for noise of the step."""

    def log_ratio(self, sums: Floats) -> Floats:
        """Return log p/q (M,) of the steps over which the sums (M, A) were taken; p is standard normal."""


@dataclass(frozen=True)
class TapeLaw:
    """Law that the tapes of a request are drawn from (``Request.tape_law``).

    Attributes:
        proposal: The proposal.
        from_target: Draw from the target instead (or use given tapes), and weigh against the proposal all
            the same.
    """

    proposal: TapeProposal
    from_target: bool = False
