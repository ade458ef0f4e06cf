"""Route of a climb: entry level, the levels on to failure, and how chains move between them.

A pilot of chains finds it. It is kept with the proposal, so that another run climbs without learning.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from avrare.base.errors import UsageError
from avrare.estimation.plan.plan import Plan
from avrare_estimators.common.chains.level_pass import LevelPass, LevelRecord
from avrare_estimators.common.tapes.tape_mixture import TapeMixture
from avrare_estimators.importance.entry import LENGTH, Entry, climb_cost, start_variance

PILOT_CHAINS = 100
"""Chains of a pilot where they are affordable: a few starts have offspring two factors of ten away."""
LEAST_GROUPS = 12
FEWEST_CHAINS, _MOST_CHAINS = 20, 400
_SAMPLE_TAPES = 4
"""Tapes of each sample of a group at the peak: old, new, and the chains'."""
_NUMBERS = ("probability", "variance", "lasting", "chance", "reached")


@dataclass(frozen=True)
class Route:
    """Levels that a pilot has found.

    Attributes:
        entry: The entry.
        levels: Scores of the levels, that of the entry first.
        angles: Size of the chains' steps at each level [rad].
        lasting: Relative variance of the offspring of a start that is the start's own: it stays however many
            chains leave from there. Offspring are the samples that fail.
        chance: Relative variance that one chain adds.
        reached: Estimated probability of failure, from the same rows as that of the entry; 0: not reached.
    """

    entry: Entry
    levels: tuple[float, ...]
    angles: tuple[float, ...]
    lasting: float
    chance: float
    reached: float

    @staticmethod
    def of(entry: Entry, pilot: LevelPass) -> Route:
        """Return what an ended pilot of one group has found."""
        failed = pilot.failed
        shares = [(record.share[0], record.effective[0], record.lasting[0]) for record in pilot.levels[1:]]
        shares.append((failed.mean(), pilot.effective(failed)[0], pilot.lasting(failed)[0]))
        lasting, chance = 1.0, 0.0
        for share, effective, own in shares:
            if share > 0.0:
                lasting *= 1.0 + float(own)
                chance += pilot.shape.chains * float((1.0 - share) / (share * effective))
        levels = tuple(float(record.level[0]) for record in pilot.levels)
        angles = tuple(float(record.tuning[0]) for record in pilot.levels)
        return Route(entry, levels, angles, lasting - 1.0, chance, float(pilot.probabilities[0]))

    @property
    def moves(self) -> int:
        """Rollouts of a chain."""
        return len(self.levels) * (LENGTH - 1)

    def cost(self) -> float:
        """Return the relative variance times rollouts, sample and chains divided as is best."""
        return climb_cost(self.entry.variance, self.lasting, self.chance, self.moves)

    def sized(self, goal: float | None, affordable: float, most: int) -> GroupSize:
        """Return the size of the groups, and how many of them half of the work takes.

        Args:
            goal: Relative error to reach; None: the rollouts are spent.
            affordable: Most rollouts of all groups.
            most: Most chains of a group.
        """
        variance = start_variance(self.entry.variance, self.lasting)
        # 1. Rows for each chain, as divides the work best.
        rows = math.sqrt(variance * self.moves / max(self.chance, 1e-9))
        rows = min(max(rows, self.moves / 3.0), 10.0 * self.moves)
        # 2. Chains of half of the work, divided among the groups.
        total = affordable / (rows + self.moves)
        if goal is not None:
            total = min(total, (variance / rows + self.chance) / goal**2 / 2.0)
        size = int(min(max(total / LEAST_GROUPS, FEWEST_CHAINS), _MOST_CHAINS, most))
        first = max(LEAST_GROUPS, int(total / size))
        return GroupSize(max(4, round(rows * size)), size, first, len(self.levels))

    def schedule(self, groups: int) -> tuple[LevelRecord, ...]:
        """Return the levels and step sizes for groups that follow them."""
        passed, none = np.ones(groups, dtype=bool), np.full(groups, np.nan)
        return tuple(
            LevelRecord(np.full(groups, level), passed, none, none, np.full(groups, angle), none, none, none)
            for level, angle in zip(self.levels, self.angles, strict=True)
        )

    def to_dict(self) -> dict[str, object]:
        """Return the route as JSON data; the proposal is told apart."""
        return {
            "levels": list(self.levels),
            "angles": list(self.angles),
            "probability": self.entry.probability,
            "variance": self.entry.variance,
            "lasting": self.lasting,
            "chance": self.chance,
            "reached": self.reached,
        }

    @staticmethod
    def from_dict(content: Mapping[str, Any], mixture: TapeMixture) -> Route:
        """Return the route of JSON data.

        Raises:
            UsageError: The data are damaged.
        """
        try:
            levels, angles = (tuple(map(float, content[name])) for name in ("levels", "angles"))
            probability, variance, lasting, chance, reached = (float(content[name]) for name in _NUMBERS)
        except (KeyError, TypeError, ValueError) as error:
            raise _damaged(f"{type(error).__name__}: {error}") from None
        numbers = [*levels, *angles, probability, variance, lasting, chance, reached]
        if not levels or len(levels) != len(angles) or not np.isfinite(numbers).all():
            raise _damaged("levels and angles must be as many finite numbers")
        if not (0.0 < probability <= 1.0 and min(variance, lasting, chance) >= 0.0 and min(angles) > 0.0):
            raise _damaged("a number is out of its range")
        return Route(
            Entry(levels[0], probability, variance, mixture), levels, angles, lasting, chance, reached
        )


@dataclass(frozen=True)
class GroupSize:
    """Size of the groups that count.

    Attributes:
        rows: Rows of a group's sample.
        chains: Chains of a group.
        first: Groups before the first look.
        levels: Levels at which the chains move.
    """

    rows: int
    chains: int
    first: int
    levels: int

    @property
    def cost(self) -> int:
        """Rollouts of a group."""
        return self.rows + self.levels * self.chains * (LENGTH - 1)


def chain_bytes(plan: Plan) -> int:
    """Return the memory that each chain of a group takes at the peak."""
    return _SAMPLE_TAPES * LENGTH * plan.tape_bytes


def _damaged(reason: str) -> UsageError:
    return UsageError(f"the climb of a learned proposal is damaged: {reason}", "learn it again")
