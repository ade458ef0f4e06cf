"""Chains on the noise tape, all of a batch at once, and what a kernel must offer to move them.

A chain's law at a level is the noise's own, N(0, I), kept to the tapes of the level's set: those that fail
and those whose score lies strictly above the level. A kernel moves M chains by one step. It owns no loop:
it hands out proposals whose rollouts it wants to see, is told their outcome, and so on until no chain
waits. One that can solve a step in closed form returns a move in which no chain waits.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from avrare import batch
from avrare.protocols import Bools, Floats
from avrare.rollout.noise import NoiseSource
from avrare.rollout.request import Integers, Rollouts

MOST_TURNS = 1000
"""Turns (proposals of one chain in one step) that have random numbers of their own."""
TURN = 2**22
"""Distance of turns in the address of a chain; there are fewer chains."""


@dataclass(frozen=True)
class Points:
    """M tapes and what their rollouts have told.

    Attributes:
        tape: (M, steps + 1, noise_size).
        score: (M,) of the whole rollout, -inf where it broke down.
        violated: (M,) it fails; False where it broke down.
        robustness: (M,).
        root: (M,) index of the first tape that the chain descends from.
        log_weight: (M,) log of what a sample counts, up to a constant; 0 where the system reports no weights.
    """

    tape: Floats
    score: Floats
    violated: Bools
    robustness: Floats
    root: Integers
    log_weight: Floats

    @staticmethod
    def of(tape: Floats, rollouts: Rollouts, root: Integers) -> Points:
        """The outcome of rollouts of ``tape``, one row each."""
        score = np.where(rollouts.error, -np.inf, rollouts.scores[:, -1])
        violated, robustness = rollouts.violated[:, 0], rollouts.robustness[:, 0]
        return Points(tape, score, violated, robustness, root, rollouts.log_weight)

    @property
    def key(self) -> Floats:
        """(M,) the order of levels: by score, all failures on top, whatever their score."""
        return np.where(self.violated, np.inf, np.minimum(self.score, np.finfo(np.float64).max))

    def above(self, level: Floats) -> Bools:
        """(M,) in the set of (M,) levels; a rollout that broke down is in none."""
        return self.key > level

    def updated(self, rows: Integers, new: Points) -> Points:
        """With ``rows`` replaced by the points ``new``; roots stay."""
        names = ("tape", "score", "violated", "robustness", "log_weight")
        values = {name: getattr(self, name).copy() for name in names}
        for name in names:
            values[name][rows] = getattr(new, name)
        return replace(self, **values)


@dataclass(frozen=True)
class Draw:
    """The random numbers of one step of M chains, addressed by (run, stage, chain).

    Attributes:
        noise: Where they come from.
        steps: Of a rollout.
        run: (M,).
        stage: Of the step.
        chain: (M,) index in its run.
    """

    noise: NoiseSource
    steps: int
    run: Integers
    stage: int
    chain: Integers

    def tapes(self) -> Floats:
        """A standard normal tape (M, steps + 1, noise_size) for each chain."""
        steps = np.arange(self.steps + 1)
        return self.noise.normals(self.run[:, None], self.stage, self.chain[:, None], steps)

    def uniforms(self, rows: Integers, turn: int) -> Floats:
        """A number (len(rows),) in (0, 1) for each of the chains ``rows``, fresh each turn < MOST_TURNS."""
        return self.noise.choices(self.run[rows], self.stage, self.chain[rows] + turn * TURN)


@dataclass(frozen=True)
class Move:
    """One step of M chains, on its way.

    Attributes:
        state: Where the chains are; where they have come to once none waits.
        level: (M,) that the chains must stay above.
        draw: Their random numbers.
        waiting: (W,) chains whose proposals want a rollout; empty: the step is done.
        proposal: (W, steps + 1, noise_size).
        turn: Proposals handed out so far, per chain.
        accepted: (M,) the chain has taken a proposal.
        work: The kernel's own, any batch with leading axis M.
    """

    state: Points
    level: Floats
    draw: Draw
    waiting: Integers
    proposal: Floats
    turn: int
    accepted: Bools
    work: Any

    @staticmethod
    def begin(state: Points, level: Floats, draw: Draw, proposal: Floats, work: Any) -> Move:
        """The first turn: all chains wait for their proposals."""
        chains = len(level)
        return Move(state, level, draw, np.arange(chains), proposal, 1, np.zeros(chains, dtype=bool), work)

    def take(self, good: Bools, found: Points) -> Move:
        """The waiting chains that are ``good`` (W,) go to their points of ``found`` and wait no longer."""
        rows = self.waiting[good]
        accepted = self.accepted.copy()
        accepted[rows] = True
        state = self.state.updated(rows, batch.take(found, good))
        rest = ~good
        return replace(
            self, state=state, accepted=accepted, waiting=self.waiting[rest], proposal=self.proposal[rest]
        )

    def stay(self) -> Move:
        """The chains that still wait stay where they are."""
        return replace(self, waiting=self.waiting[:0], proposal=self.proposal[:0])


@dataclass(frozen=True)
class Info:
    """What a finished step was like, for adaptation.

    Attributes:
        run: (M,) run of each chain, 0..runs-1.
        accepted: (M,) the chain has taken a proposal.
        work: The kernel's own, as the move left it.
    """

    run: Integers
    accepted: Bools
    work: Any


class Kernel(Protocol):
    """A Markov kernel that leaves the law of a level's set as it is.

    What it learns is a batch with leading axis R, one row a run; it learns in the pilot only, and each level
    keeps what had been learnt there for the pass that counts. One that must know the system, to solve a
    step in closed form, also has ``of(problem) -> Kernel``. One that can see whether what it takes for
    granted holds also has ``watch(known, info) -> known``, called after every step of either pass (in the
    pass that counts from ``init`` on, and chains do not move by it), and ``warnings(known)``, health
    warnings by name.

    Attributes:
        note: What is wrong with it; empty for a valid kernel.
        rollouts: Typical number of rollouts of a step, for budgets.
    """

    note: str
    rollouts: float

    def init(self, runs: int) -> Any:
        """What is known before the first level."""

    def learn(self, known: Any, runs: Integers, points: Points, level: Floats) -> Any:
        """What is known of a new level: ``runs`` (A,) have ``points`` (A N rows) and next levels (A,)."""

    def start(self, known: Any, state: Points, level: Floats, draw: Draw) -> Move:
        """A step begins; ``known`` has a row for each chain."""

    def tell(self, move: Move, found: Points) -> Move:
        """The step goes on: ``found`` are the proposals of the waiting chains."""

    def adapt(self, known: Any, info: Info) -> Any:
        """What a finished step teaches; called in the pilot only."""


class Untaught:
    """A kernel that learns nothing."""

    note = ""

    def init(self, runs: int) -> Any:
        """Nothing."""
        return ()

    def learn(self, known: Any, runs: Integers, points: Points, level: Floats) -> Any:
        """Nothing."""
        return known

    def adapt(self, known: Any, info: Info) -> Any:
        """Nothing."""
        return known


def rotated(tape: Floats, other: Floats, angle: Floats) -> Floats:
    """Turn tapes: tape cos(angle) + other sin(angle), row by row: normal where both are.

    Args:
        tape: (M, steps + 1, noise_size).
        other: The same shape.
        angle: (M,) radians.
    """
    return np.asarray(np.cos(angle)[:, None, None] * tape + np.sin(angle)[:, None, None] * other)
