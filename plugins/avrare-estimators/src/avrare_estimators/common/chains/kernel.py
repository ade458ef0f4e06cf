"""Markov chains on the noise tape, all of a batch at once, and the protocol of the kernels that move them.

A chain's law at a level is the noise's own, N(0, I), restricted to the tapes of the level's set: those that
fail and those whose score lies strictly above the level. A kernel moves M chains by one step. It owns no
loop: it hands out proposals that want a rollout and takes in their outcomes, until no chain waits. A
kernel that solves a step in closed form returns a move in which no chain waits.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from avrare.base import batch
from avrare.protocols import Bools, Floats
from avrare.rollout.noise import NoiseSource
from avrare.rollout.request import Integers, Rollouts

TURN = 2**22
"""Distance of turns in the address of a chain; there are fewer chains."""


@dataclass(frozen=True)
class Points:
    """M tapes with the outcomes of their rollouts.

    Attributes:
        tape: (M, steps + 1, noise_size).
        score: (M,) of the complete rollout, -inf where it broke down.
        violated: (M,) the rollout fails; False where it broke down.
        robustness: (M,).
        root: (M,) index of the first tape that the chain descends from.
        log_weight: (M,) log weight up to a constant; 0 where the system reports no weights.
    """

    tape: Floats
    score: Floats
    violated: Bools
    robustness: Floats
    root: Integers
    log_weight: Floats

    @staticmethod
    def of(tape: Floats, rollouts: Rollouts, root: Integers) -> Points:
        """Return the points of ``tape`` and its rollouts, one row each."""
        score = np.where(rollouts.error, -np.inf, rollouts.scores[:, -1])
        violated, robustness = rollouts.violated[:, 0], rollouts.robustness[:, 0]
        return Points(tape, score, violated, robustness, root, rollouts.log_weight)

    @property
    def key(self) -> Floats:
        """(M,) order of levels: by score, all failures on top, whatever their score."""
        return np.where(self.violated, np.inf, np.minimum(self.score, np.finfo(np.float64).max))

    def above(self, level: Floats) -> Bools:
        """Return whether each point (M,) lies in the set of its level; rollouts that broke down never do."""
        return self.key > level

    def update(self, rows: Integers, new: Points) -> Points:
        """Return a copy with ``rows`` replaced by the points ``new``; roots stay."""
        return replace(self.replace_rows([rows], [new]), root=self.root)

    def replace_rows(self, places: Sequence[Integers], replacements: Sequence[Points]) -> Points:
        """Return a copy with the rows of each of ``places`` replaced, roots included."""
        values = {}
        for array in fields(self):
            values[array.name] = getattr(self, array.name).copy()
            for rows, replacement in zip(places, replacements, strict=True):
                values[array.name][rows] = getattr(replacement, array.name)
        return Points(**values)


@dataclass(frozen=True)
class Draw:
    """The random numbers of one step of M chains, addressed by (run, stage, chain).

    Attributes:
        noise: Source of the numbers.
        steps: Steps of a rollout.
        run: (M,) run of each chain.
        stage: Stage of the step.
        chain: (M,) index of the chain in its run.
    """

    noise: NoiseSource
    steps: int
    run: Integers
    stage: int
    chain: Integers

    def tapes(self) -> Floats:
        """Draw a standard normal tape (M, steps + 1, noise_size) for each chain."""
        steps = np.arange(self.steps + 1)
        return self.noise.normals(self.run[:, None], self.stage, self.chain[:, None], steps)

    def uniforms(self, rows: Integers, turn: int) -> Floats:
        """Draw a number (len(rows),) in (0, 1) for each of the chains ``rows``, fresh in each turn < 1000."""
        return self.noise.choices(self.run[rows], self.stage, self.chain[rows] + turn * TURN)


@dataclass(frozen=True)
class Move:
    """One step of M chains, under way.

    Attributes:
        state: Present points of the chains; their next ones once no chain waits.
        level: (M,) level that each chain must stay above.
        draw: Random numbers of the step.
        waiting: (W,) chains whose proposals want a rollout; empty: the step is done.
        proposal: (W, steps + 1, noise_size).
        turn: Number of proposals handed out so far, per chain.
        accepted: (M,) the chain has accepted a proposal.
        work: Data of the kernel, any batch with leading axis M.
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
    def begin(state: Points, level: Floats, draw: Draw, proposal: Floats, work: object) -> Move:
        """Return the first turn: all chains wait for their proposals."""
        chains = len(level)
        return Move(state, level, draw, np.arange(chains), proposal, 1, np.zeros(chains, dtype=bool), work)

    def accept(self, good: Bools, points: Points) -> Move:
        """Move the waiting chains that are ``good`` (W,) to ``points`` (W,): they are done."""
        rows = self.waiting[good]
        accepted = self.accepted.copy()
        accepted[rows] = True
        state = self.state.update(rows, batch.take(points, good))
        rest = ~good
        return replace(
            self, state=state, accepted=accepted, waiting=self.waiting[rest], proposal=self.proposal[rest]
        )

    def stay(self) -> Move:
        """Leave the chains that still wait where they are."""
        return replace(self, waiting=self.waiting[:0], proposal=self.proposal[:0])


@dataclass(frozen=True)
class StepOutcome:
    """Outcome of a finished step, for adaptation.

    Attributes:
        run: (M,) run of each chain, 0..runs-1.
        accepted: (M,) the chain has accepted a proposal.
        work: Data of the kernel, as the move left it.
    """

    run: Integers
    accepted: Bools
    work: Any


class Kernel:
    """A Markov kernel that leaves the law of a level's set invariant; by default it learns nothing.

    Its tuning, which it learns, is a batch with leading axis R, one row a run. It learns in the pilot, and
    each level stores the tuning for the pass that counts.

    Attributes:
        name: Its name in a result.
        note: Reason to doubt the kernel; empty for a valid one.
        rollouts: Typical number of rollouts of a step, for budgets.
    """

    name = ""
    note = ""
    rollouts = 1.0

    def init(self, runs: int) -> object:
        """Return the tuning before the first level."""
        return ()

    def start(self, tuning: Any, state: Points, level: Floats, draw: Draw) -> Move:
        """Begin a step; ``tuning`` has a row for each chain."""
        raise NotImplementedError

    def tell(self, move: Move, points: Points) -> Move:
        """Continue the step; ``points`` are the proposals of the waiting chains."""
        raise NotImplementedError

    def adapt(self, tuning: Any, outcome: StepOutcome) -> object:
        """Return the tuning after a finished step; called in the pilot only."""
        return tuning

    def watch(self, tuning: Any, outcome: StepOutcome) -> object:
        """Return the tuning after a step of either pass (in the one that counts, chains ignore it)."""
        return tuning

    def warnings(self, tuning: Any) -> dict[str, str]:
        """Return health warnings by name, where the kernel's assumptions do not hold."""
        return {}


def rotate(tape: Floats, other: Floats, angle: Floats) -> Floats:
    """Return tape cos(angle) + other sin(angle), row by row: standard normal where both are.

    Args:
        tape: (M, steps + 1, noise_size).
        other: The same shape.
        angle: (M,) radians.
    """
    return np.asarray(np.cos(angle)[:, None, None] * tape + np.sin(angle)[:, None, None] * other)
