"""Sources of weighted rows: the target, and laws of tapes or perception models to draw from in its place.

A row's tape is a function of seed, run, stage and row alone, and can be drawn again. A source makes the
requests to the rollout engine, and gives log p/q of the rollouts.
"""

# ruff: noqa: D102 - ``Source`` documents the methods of all sources.

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from avrare.base.errors import UsageError
from avrare.estimation.plan.plan import Plan
from avrare.protocols import Floats
from avrare.rollout.request import CHOICES, FROM_START, Integers, Request, Rollouts
from avrare.stack.closed_loop import SamplingLaw
from avrare_estimators.common.tapes.gaussian_mixture import NoiseProposal
from avrare_estimators.common.tapes.tape_mixture import TapeMixture

BLOCK = 256
"""Rows that a proposal draws at a time: it knows no addresses, and results must not depend on chunks."""


@dataclass(frozen=True)
class Stratum:
    """Rows of one sample that share a law.

    Attributes:
        plan: The task.
        run: Address of the noise.
        stage: Address of the noise.
        rows: Number of rows.
        from_target: The rows are drawn from the target.
        first: Address of the first row.
    """

    plan: Plan
    run: int
    stage: int
    rows: int
    from_target: bool
    first: int = 0

    def normals(self, index: Integers) -> Floats:
        """Return standard normal tapes (len(index), steps + 1, noise_size) of rows ``index``."""
        steps = np.arange(self.plan.steps + 1)
        return self.plan.noise.normals(self.run, self.stage, self.first + index[:, None], steps)


class Source(Protocol):
    """A proposal in use.

    Attributes:
        replayable: Its tapes mean the same to the problem that the user gave.
    """

    replayable: bool

    def tapes(self, stratum: Stratum, index: Integers) -> Floats:
        """Draw the tapes (len(index), steps + 1, noise_size) of rows ``index`` again."""

    def replay(self, tapes: Floats) -> Request:
        """Return the request for rollouts of given tapes; where not ``replayable``, of the target."""

    def log_ratio(self, request: Request, rollouts: Rollouts) -> Floats:
        """Return log p/q (M,) of the rollouts of a request."""


@dataclass(frozen=True)
class LatentSource:
    """Tapes from a law of the noise; None stands for the target, whose log p/q is 0."""

    proposal: NoiseProposal | None
    replayable = True

    def tapes(self, stratum: Stratum, index: Integers) -> Floats:
        """Draw the tapes of rows ``index`` again, in blocks that do not depend on chunks."""
        if stratum.from_target or self.proposal is None:
            return stratum.normals(index)
        tapes = np.empty((len(index), stratum.plan.steps + 1, stratum.plan.noise.noise_size))
        for block in np.unique(index // BLOCK):
            rows = index // BLOCK == block
            drawn = self._draw_block(stratum, int(block), min(BLOCK, stratum.rows - int(block) * BLOCK))
            tapes[rows] = drawn[index[rows] - block * BLOCK]
        return tapes

    def _draw_block(self, stratum: Stratum, block: int, rows: int) -> Floats:
        assert self.proposal is not None
        plan = stratum.plan
        seeds = np.random.SeedSequence(plan.noise.seed, spawn_key=(stratum.run, stratum.stage, block))
        drawn = _call_proposal("sample", self.proposal.sample, np.random.default_rng(seeds), rows)
        expected = (rows, plan.steps + 1, plan.noise.noise_size)
        if drawn.shape != expected:
            raise UsageError(
                f"the proposal's sample(rng, {rows}) has shape {drawn.shape}, not {expected}",
                "a proposal draws tapes (n, steps + 1, noise_size)",
            )
        return drawn

    def replay(self, tapes: Floats) -> Request:
        return Request.replay(tapes)

    def log_ratio(self, request: Request, rollouts: Rollouts) -> Floats:
        assert request.tape is not None
        if self.proposal is None:
            return np.zeros(request.rows)
        ratio = _call_proposal("log_ratio", self.proposal.log_ratio, request.tape)
        if ratio.shape != (request.rows,) or np.isnan(ratio).any():
            raise UsageError(
                f"the proposal's log_ratio has shape {ratio.shape} or NaN, not {(request.rows,)} numbers",
                "log_ratio(noise) returns log p/q of each tape",
            )
        return ratio


@dataclass(frozen=True)
class TapeSource:
    """Rows whose tapes come from a mixture on the noise tape; None stands for the target.

    Rollouts are weighed where they run.

    Attributes:
        mixture: The mixture.
        observe: Steps whose features the rollouts return.
    """

    mixture: TapeMixture | None
    observe: tuple[int, ...] = ()
    replayable = True

    def tapes(self, stratum: Stratum, index: Integers) -> Floats:
        tapes = stratum.normals(index)
        if self.mixture is not None and not stratum.from_target:
            particle = stratum.first + index
            uniform = stratum.plan.noise.choices(stratum.run, stratum.stage, particle, CHOICES)
            self.mixture.transform(tapes, self.mixture.choose(uniform), 0)
        return tapes

    def replay(self, tapes: Floats) -> Request:
        return replace(Request.replay(tapes), tape_law=self.mixture, observe=self.observe)

    def log_ratio(self, request: Request, rollouts: Rollouts) -> Floats:
        return rollouts.log_weight


@dataclass(frozen=True)
class PerceptionSource:
    """Rows drawn through another perception model; the closed loop reports log p/q of its observations.

    Attributes:
        proposal: Perception model of each request; None: the problem brings its own.
        keep_carries: Ask for the carries of every step.
        most_bytes: Limit on the carries of a row, as in ``Request``.
    """

    proposal: Any = None
    keep_carries: bool = False
    most_bytes: int = 0
    replayable = False

    def tapes(self, stratum: Stratum, index: Integers) -> Floats:
        return stratum.normals(index)

    def request(self, stratum: Stratum, index: Integers) -> Request:
        """Return the request for rollouts of rows ``index``."""
        ones = np.ones_like(index)
        law = SamplingLaw(self.proposal, stratum.from_target)
        return Request(
            stratum.run * ones,
            stratum.stage * ones,
            stratum.first + index,
            FROM_START * ones,
            keep_carries=self.keep_carries,
            most_bytes=self.most_bytes,
            law=law,
        )

    def replay(self, tapes: Floats) -> Request:
        zeros = np.zeros(len(tapes), dtype=np.int64)
        law = SamplingLaw(self.proposal, from_target=True)
        return Request(zeros, zeros, zeros, zeros + FROM_START, tape=tapes, law=law)

    def log_ratio(self, request: Request, rollouts: Rollouts) -> Floats:
        return rollouts.log_weight


def _call_proposal(name: str, method: Callable[..., object], *arguments: object) -> Floats:
    try:
        return np.asarray(method(*arguments), dtype=np.float64)
    except Exception as error:
        raise UsageError(
            f"the proposal's {name} raised {type(error).__name__}: {error}",
            "sample(rng, n) draws tapes (n, steps + 1, noise_size); log_ratio(noise) returns log p/q of each",
        ) from error
