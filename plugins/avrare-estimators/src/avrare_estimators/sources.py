"""Where the rows of a sample come from: requests to the rollout engine, and log p/q of what came back.

A sample has an address (run, stage) and two parts: rows drawn from the target itself, and rows drawn from
the proposal. Both are functions of seed, run, stage and row alone: a tape can be drawn again when asked for.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from avrare.build.weighted import Law
from avrare.errors import UsageError
from avrare.estimation.plan import Plan
from avrare.protocols import Floats
from avrare.rollout.request import FROM_START, Integers, Request, Rollouts
from avrare_estimators.proposals import NoiseProposal

BLOCK = 256
"""Rows that a proposal draws at a time: it knows no addresses, and no chunk may show in a result."""


@dataclass(frozen=True)
class Part:
    """Rows of one sample that share a law.

    Attributes:
        plan: The task.
        run: Address of the noise.
        stage: Address of the noise.
        rows: How many there are.
        from_target: Drawn from the target.
        first: Address of the first row.
    """

    plan: Plan
    run: int
    stage: int
    rows: int
    from_target: bool
    first: int = 0

    def fresh(self, index: Integers) -> Floats:
        """Standard normal tapes (len(index), steps + 1, noise_size) of rows ``index``."""
        steps = np.arange(self.plan.steps + 1)
        return self.plan.noise.normals(self.run, self.stage, self.first + index[:, None], steps)


class Source(Protocol):
    """A proposal in action."""

    replayable: bool
    """Whether its tapes mean the same to the problem that the user gave."""

    def tapes(self, part: Part, index: Integers) -> Floats:
        """Tapes (len(index), steps + 1, noise_size) of rows ``index``, drawn again."""

    def request(self, part: Part, index: Integers) -> Request:
        """Rollouts of rows ``index``."""

    def target_request(self, tapes: Floats) -> Request:
        """Rollouts of given tapes of the target."""

    def log_ratio(self, request: Request, rollouts: Rollouts) -> Floats:
        """(M,) log p/q of what was requested."""


@dataclass(frozen=True)
class LatentSource:
    """Tapes from a law of the noise; None stands for the target, whose log p/q is 0."""

    proposal: NoiseProposal | None
    replayable = True

    def tapes(self, part: Part, index: Integers) -> Floats:
        """Tapes of rows ``index``."""
        if part.from_target or self.proposal is None:
            return part.fresh(index)
        tapes = np.empty((len(index), part.plan.steps + 1, part.plan.noise.noise_size))
        for block in np.unique(index // BLOCK):
            mine = index // BLOCK == block
            many = min(BLOCK, part.rows - int(block) * BLOCK)
            tapes[mine] = self._block(part, int(block), many)[index[mine] - block * BLOCK]
        return tapes

    def _block(self, part: Part, block: int, many: int) -> Floats:
        assert self.proposal is not None
        seeds = np.random.SeedSequence(part.plan.noise.seed, spawn_key=(part.run, part.stage, block))
        drawn = _numbers("sample", self.proposal.sample, np.random.default_rng(seeds), many)
        expected = (many, part.plan.steps + 1, part.plan.noise.noise_size)
        if drawn.shape != expected:
            raise UsageError(
                f"the proposal's sample(rng, {many}) has shape {drawn.shape}, not {expected}",
                "a proposal draws tapes (n, steps + 1, noise_size)",
            )
        return drawn

    def request(self, part: Part, index: Integers) -> Request:
        """Rollouts of rows ``index``."""
        return Request.replay(self.tapes(part, index))

    def target_request(self, tapes: Floats) -> Request:
        """Rollouts of given tapes."""
        return Request.replay(tapes)

    def log_ratio(self, request: Request, rollouts: Rollouts) -> Floats:
        """(M,) log p/q of the tapes."""
        assert request.tape is not None
        if self.proposal is None:
            return np.zeros(request.rows)
        ratio = _numbers("log_ratio", self.proposal.log_ratio, request.tape)
        if ratio.shape != (request.rows,) or np.isnan(ratio).any():
            raise UsageError(
                f"the proposal's log_ratio has shape {ratio.shape} or NaN, not {(request.rows,)} numbers",
                "log_ratio(noise) returns log p/q of each tape",
            )
        return ratio


@dataclass(frozen=True)
class PerceptionSource:
    """Rows drawn through another perception model; the closed loop reports log p/q of its observations.

    Attributes:
        proposal: Travels with each request; None: the problem brings its own.
        keep_carries: The states of every step are wanted.
    """

    proposal: Any = None
    keep_carries: bool = False
    replayable = False

    def tapes(self, part: Part, index: Integers) -> Floats:
        """Tapes of rows ``index``: standard normal, whoever reads them."""
        return part.fresh(index)

    def request(self, part: Part, index: Integers) -> Request:
        """Rollouts of rows ``index``."""
        same = np.ones_like(index)
        law = Law(self.proposal, part.from_target)
        return Request(
            part.run * same, part.stage * same, part.first + index, FROM_START * same,
            keep_carries=self.keep_carries, law=law,
        )  # fmt: skip

    def target_request(self, tapes: Floats) -> Request:
        """Rollouts of given tapes, read by the target and weighed against the proposal."""
        zeros = np.zeros(len(tapes), dtype=np.int64)
        law = Law(self.proposal, from_target=True)
        return Request(zeros, zeros, zeros, zeros + FROM_START, tape=tapes, law=law)

    def log_ratio(self, request: Request, rollouts: Rollouts) -> Floats:
        """(M,) as the closed loop reports it."""
        return rollouts.log_weight


def _numbers(name: str, function: Callable[..., Any], *arguments: Any) -> Floats:
    """What a method of the user's proposal returns."""
    try:
        return np.asarray(function(*arguments), dtype=np.float64)
    except Exception as error:
        raise UsageError(
            f"the proposal's {name} raised {type(error).__name__}: {error}",
            "sample(rng, n) draws tapes (n, steps + 1, noise_size); log_ratio(noise) returns log p/q of each",
        ) from error
