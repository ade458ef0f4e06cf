"""Options of ``mfmc``, Monte Carlo with two fidelities."""

from __future__ import annotations

from pydantic import Field

from avrare.plugin import Options


class MfmcConfig(Options):
    """Options of two-phase sampling: a cheap twin on many tapes, the stack itself on those that matter."""

    rollouts: int = Field(
        default=10_000,
        ge=1,
        le=10**12,
        description="cost of the estimate, pilot included, in rollouts of the stack itself",
    )
    pilot: float = Field(
        default=0.05,
        gt=0.0,
        le=0.5,
        description="share of the cost of the pilot, which counts in no estimate: it decides which tapes of "
        "the twin are run again, or that plain Monte Carlo costs as little",
    )
