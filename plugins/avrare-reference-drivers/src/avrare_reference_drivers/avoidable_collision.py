"""Specification by EU 2022/1426: no collision with a vehicle that cuts in early enough."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from avrare.base.errors import UsageError
from avrare.driving import Scene
from avrare.protocols import Bools, Floats, Signals, Specification, Verdict
from avrare_reference_drivers.config import AvoidableCollisionConfig

_NEEDS = ("ego_x", "ego_y", "ego_speed", "others_x", "others_y", "others_speed", "others_heading", "distance")


def avoidable_ttc(closing: Floats, standing_passengers: bool = False) -> Floats:
    """Return the time to collision at intrusion from which a collision must be avoided [s].

    It is closing / (2 b) + tau, with b = 6 m/s^2 and tau = 0.25 s; with standing passengers 2.4 and 0.16.
    """
    braking, delay = (2.4, 0.16) if standing_passengers else (6.0, 0.25)
    return closing / (2.0 * braking) + delay


@dataclass(frozen=True)
class CutIns:
    """Monitor state.

    Attributes:
        intruded: (N, V) whether a vehicle has come into the ego's lane.
        spare: (N, V) its time to collision then, less the bound [s].
        distance: (N, V) least distance so far [m].
        score: (N,) running maximum of how near a failure has come.
    """

    intruded: Bools
    spare: Floats
    distance: Floats
    score: Floats


class AvoidableCollision(Specification):
    """Monitor of "cut in early enough implies no collision", for each vehicle."""

    words = "No collision with a vehicle that cuts in as early as EU 2022/1426 demands."

    def __init__(self, config: AvoidableCollisionConfig, scene: Scene) -> None:
        self._config, self._scene = config, scene

    def start(self, n: int) -> CutIns:
        """Return the monitor state of ``n`` particles before sample 0."""
        shape = (n, len(self._scene.names))
        return CutIns(
            np.zeros(shape, dtype=np.bool_), np.zeros(shape), np.full(shape, np.inf), np.full(n, -np.inf)
        )

    def update(self, state: CutIns, signals: Signals) -> tuple[CutIns, Verdict]:
        """Return the monitor state and the verdict after one more sample.

        Raises:
            UsageError: A signal does not exist.
        """
        if lacking := [name for name in _NEEDS if name not in signals]:
            raise UsageError(
                f"avoidable_collision needs the signal {lacking[0]!r}",
                "use a driving simulator, such as single_track",
            )
        new = self._intrudes(signals) & ~state.intruded
        spare = np.where(new, self._spare(signals), state.spare)
        intruded = state.intruded | new
        distance = np.minimum(state.distance, signals["distance"])
        # a vehicle beside the ego's lane has not cut in: nothing is asked of the ego yet
        margin = np.where(intruded, np.maximum(-spare, distance), np.maximum(distance, np.finfo(float).tiny))
        robustness = margin.min(axis=1, initial=np.inf)
        violated = np.asarray((intruded & (spare >= 0.0) & (distance <= 0.0)).any(axis=1))
        score = np.maximum(state.score, -robustness)
        return CutIns(intruded, spare, distance, score), Verdict(robustness, violated, score)

    def _intrudes(self, signals: Signals) -> Bools:
        road = self._scene.road
        centres = np.array(road.lane_centres)
        y = np.asarray(signals["ego_y"])
        lane = centres[np.abs(y[:, None] - centres).argmin(axis=1)]
        side = np.abs(signals["others_y"] - lane[:, None]) - 0.5 * self._scene.widths
        return np.asarray(side <= 0.5 * road.lane_width - self._config.intrusion)

    def _spare(self, signals: Signals) -> Floats:
        along = signals["others_speed"] * np.cos(signals["others_heading"])
        closing = np.asarray(signals["ego_speed"])[:, None] - along
        ahead = signals["others_x"] - np.asarray(signals["ego_x"])[:, None]
        gap = ahead - 0.5 * (self._scene.ego_length + self._scene.lengths)
        with np.errstate(divide="ignore", invalid="ignore"):
            ttc = np.where(closing > 0.0, gap / closing, np.inf)
        # a vehicle that is behind or beside the ego when it intrudes leaves the ego no way out
        return np.where(ahead > 0.0, ttc - avoidable_ttc(closing, self._config.standing_passengers), -np.inf)


def build(config: AvoidableCollisionConfig, scene: Scene) -> AvoidableCollision:
    """Build the monitor of a scenario."""
    return AvoidableCollision(config, scene)
