"""Stretches without a lane, as obstacles: where a lane begins or ends, a long obstacle stands in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from avrare.driving import Road, Scene, Vehicles
from avrare.driving.lanes import lane_ends
from avrare.protocols import Floats
from avrare_mpc.bends import measure_along_ego_offset

_LONG = 1e4
"""Length of the obstacle there [m]."""


@dataclass(frozen=True)
class LaneGaps:
    """Stretches before the begin or beyond the end of lanes.

    Attributes:
        edges: (K,) x of where the lane begins or ends [m].
        sides: (K,) -1: the lane is missing before; 1: beyond.
        offsets: (K,) y of the lane's centre [m].
    """

    edges: Floats
    sides: Floats
    offsets: Floats

    def fill(self, scene: Scene) -> Scene:
        """Return the scene with an obstacle in each."""
        count = len(self.edges)
        return replace(
            scene,
            names=(*scene.names, *(f"gap {k} in a lane" for k in range(count))),
            lengths=np.append(scene.lengths, np.full(count, _LONG)),
            widths=np.append(scene.widths, np.zeros(count)),
            moving=np.append(scene.moving, np.zeros(count, dtype=bool)),
        )

    def extend(self, others: tuple[Floats, Floats], ego: Vehicles, road: Road) -> tuple[Floats, Floats]:
        """Return predicted x and y (N, V + K, H + 1), those of the obstacles last, beside the ego."""
        n, _, nodes = others[0].shape
        edges = np.broadcast_to(self.edges[:, None], (n, len(self.edges), 1))
        if road.line is not None:
            edges = measure_along_ego_offset(road.line, ego, edges)
        middles = np.broadcast_to(edges + 0.5 * _LONG * self.sides[:, None], (n, len(self.edges), nodes))
        offsets = np.broadcast_to(self.offsets[:, None], middles.shape)
        return np.concatenate([others[0], middles], axis=1), np.concatenate([others[1], offsets], axis=1)

    def speed_limit(self, ego: Vehicles, goal: Floats, scene: Scene, braking: float) -> Floats:
        """Return the speed (N,) from which the ego can stop before its lane ends; inf where it leaves it.

        Args:
            ego: State of the ego.
            goal: (N,) y where its plan ends [m].
            scene: Road and sizes.
            braking: Deceleration [m/s^2].
        """
        half = 0.5 * scene.road.lane_width
        stays = [np.abs(y[:, None] - self.offsets) < half for y in (ego.y, goal)]
        # it stops 1 m before the end of its lane
        left = self.edges - ego.x[:, None] - 0.5 * scene.ego_length - 1.0
        stopping = np.sqrt(2.0 * braking * np.maximum(left, 0.0))
        limits = np.where(stays[0] & stays[1] & (self.sides > 0.0), stopping, np.inf)
        return np.asarray(limits.min(axis=1, initial=np.inf))


def find_gaps(road: Road, lanes: Sequence[int]) -> LaneGaps:
    """Return the stretches without some of ``lanes``, where others of the road are there."""
    gaps = []
    if road.lanes:
        begin, end = lane_ends(road)
        reach = 1.0  # a through lane may lack so much of the road [m]
        for lane in lanes:
            if begin[lane] > begin.min() + reach:
                gaps.append((begin[lane], -1.0, road.lane_centres[lane]))
            if end[lane] < end.max() - reach:
                gaps.append((end[lane], 1.0, road.lane_centres[lane]))
    return LaneGaps(*np.array(gaps).reshape(-1, 3).T)
