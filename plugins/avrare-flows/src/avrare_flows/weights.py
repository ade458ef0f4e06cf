"""Noise from a flow that is not quite the noise that is meant, with the weights that put it right.

A flow b sends normal numbers z to x = b(z), whose density is q(x) = N(z) / |det b'(z)|. Where the density P
that is meant is known, a row weighs P(x) / q(x), and a rollout the product over its rows. The weight of
stl-ess, Eq. 20, is |det b'(z)| alone: P / N is missing, and even an exact flow is led astray.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal, Protocol

import numpy as np

from avrare.errors import UsageError, did_you_mean
from avrare.protocols import Bools, Floats, Signals, System
from avrare_flows.blocks import Warped
from avrare_flows.laws import Law, log_normal_density
from avrare_flows.system import check_size

Weights = Literal["importance", "paper"]
WEIGHTS = ("importance", "paper")
_PAPER = (
    "weights as in stl-ess, Eq. 20: the determinant of the flow without the ratio of the densities; the "
    "estimate converges to E[|det|, failure] / E[|det|], which is not the failure probability"
)


_TAILS = (
    "the weights put right what the fitted flow draws; failures that it hardly ever draws are missed without "
    "a sign: compare with an exact transform, or with another flow"
)


class WarpedLaw(Law, Protocol):
    """A law that knows its density by the determinant of its map (``avrare_flows.flow.Flow``)."""

    def warp(self, z: Floats) -> Warped:
        """Rows (N, n) of standard normal rows, and log |det| (N,)."""


@dataclass(frozen=True)
class WeightedState:
    """State of the system and its weight.

    Attributes:
        state: Of the system over physical noise.
        log_weight: (N,) log of the product of the weights of all rows so far.
    """

    state: Any
    log_weight: Floats


@dataclass(frozen=True, eq=False)
class WeightedSystem:
    """A system whose rollouts have weights, for estimators that ask for them with ``weighing()``.

    Without having been asked for its weights it does not run: an estimator that does not know of them would
    give the probability under the flow.

    Attributes:
        system: Over physical noise.
        flow: Of its noise.
        log_density: Of the noise that is meant, (N, n) -> (N,); None: weights as in the paper.
        first: Exact law of row 0, without weights; None: the flow too.
        asked: ``weighing`` has been called.
    """

    system: System
    flow: WarpedLaw
    log_density: Callable[[Floats], Floats] | None
    first: Law | None
    asked: bool = False

    @property
    def noise_size(self) -> int:
        """Numbers of a row."""
        return self.system.noise_size

    @property
    def notes(self) -> dict[str, str]:
        """Health warnings that every result of it must carry."""
        if self.log_density is None:
            return {"paper_weights": _PAPER}
        return {"flow_tails": _TAILS} if self.flow.note else {}

    def weighing(self) -> WeightedSystem:
        """The same system, ready to run."""
        return replace(self, asked=True)

    def initial(self, noise: Floats) -> WeightedState:
        """The state at t = 0.

        Raises:
            UsageError: Nobody has asked for the weights.
        """
        if not self.asked:
            raise UsageError(
                "this noise comes with weights, of which the estimator knows nothing",
                "use ess; to replay tapes, use avrare_flows.transformed(system, flow)",
            )
        if self.first is not None:
            return WeightedState(self.system.initial(self.first.physical(noise)), np.zeros(len(noise)))
        x, weight = self._warped(noise)
        return WeightedState(self.system.initial(x), weight)

    def step(self, state: WeightedState, noise: Floats) -> WeightedState:
        """The state one step later."""
        x, weight = self._warped(noise)
        return WeightedState(self.system.step(state.state, x), state.log_weight + weight)

    def signals(self, state: WeightedState) -> Signals:
        """The system's."""
        return self.system.signals(state.state)

    def faults(self, state: WeightedState) -> Bools:
        """(N,) rows that broke down, or whose weight is no number."""
        own = getattr(self.system, "faults", None)
        lost = np.isnan(state.log_weight)
        return lost if own is None else np.asarray(own(state.state), dtype=bool) | lost

    def log_weights(self, state: WeightedState) -> Floats:
        """(N,) log of the weights."""
        return state.log_weight

    def _warped(self, noise: Floats) -> Warped:
        """Physical rows and the log of their weights."""
        x, log_det = self.flow.warp(noise)
        if self.log_density is None:
            return x, log_det
        density = np.asarray(self.log_density(x), dtype=np.float64)
        return x, density + log_det - log_normal_density(noise)


def weighted(
    system: System, flow: WarpedLaw, log_density: Callable[[Floats], Floats] | None = None, *,
    weights: Weights = "importance", initial: Law | None = None,
) -> WeightedSystem:  # fmt: skip
    """A system over physical noise that a flow draws and weights put right; for the estimator ``ess``.

    Args:
        system: Its ``initial`` and ``step`` take physical noise (N, n).
        flow: What the noise is drawn from.
        log_density: Log density (N,) of the rows (N, n) that are meant, up to a constant. It must be 0
            (-inf in logs) nowhere else than where it should: what the flow cannot reach is lost.
        weights: "importance": P/q. "paper": stl-ess, Eq. 20, which is wrong, to compare with.
        initial: Exact law of row 0, where it is another one.

    Raises:
        UsageError: A size or an option does not fit.
    """
    if weights not in WEIGHTS:
        raise UsageError(f"there are no weights {weights!r}", did_you_mean(str(weights), WEIGHTS))
    if (log_density is None) == (weights == "importance"):
        raise UsageError(
            "importance weights need log_density, weights as in the paper take none",
            "where only samples are known no weight helps: use avrare_flows.transformed(system, flow)",
        )
    for law in (flow, initial or flow):
        check_size(law, system.noise_size)
    return WeightedSystem(system, flow, log_density, initial)
