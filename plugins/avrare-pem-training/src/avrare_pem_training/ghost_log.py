"""False detections of a log, and the law that is fitted to them.

Their rate is their mean number in a frame. Between two frames dt apart one stays with probability
exp(-dt / persistence); the persistence is the most likely one for all of them that have a track. Their places
are those of the log where one appears, each the centre of a normal law (Scott 1992).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from avrare.base.errors import UsageError
from avrare.protocols import Bools, Floats
from avrare_gp_pem.config import MOST_GHOST_SLOTS
from avrare_gp_pem.runtime.variant import MeasuredGhosts

_LEAST = 20  # false detections in the training frames for a fit


@dataclass(frozen=True)
class GhostLog:
    """False detections, n of them.

    Attributes:
        right: (n,) place in the frame of the ego [m].
        forward: (n,) [m].
        track: (n,) number of the false object; NaN where unknown.
        time: (n,) time of the frame [s].
        frames: (f,) times of all frames of the log, ascending [s].
    """

    right: Floats
    forward: Floats
    track: Floats
    time: Floats
    frames: Floats

    def split(self, share: float) -> tuple[GhostLog, GhostLog]:
        """Return the first ``share`` of the frames, and the rest."""
        border = int(share * len(self.frames))
        if not 0 < border < len(self.frames):
            return self, self._take(np.zeros(len(self.time), bool), self.frames[:0])
        early = self.time < self.frames[border]
        return self._take(early, self.frames[:border]), self._take(~early, self.frames[border:])

    def _take(self, rows: Bools, frames: Floats) -> GhostLog:
        return GhostLog(self.right[rows], self.forward[rows], self.track[rows], self.time[rows], frames)


def fit_ghosts(log: GhostLog) -> MeasuredGhosts | None:
    """Fit rate, persistence and places; None for fewer than 20 false detections.

    Raises:
        UsageError: There are more in a frame than a model can draw.
    """
    if len(log.time) < _LEAST:
        return None
    rate = len(log.time) / len(log.frames)
    if rate > MOST_GHOST_SLOTS / 2:
        raise UsageError(
            f"{rate:.0f} false detections in a frame, where {MOST_GHOST_SLOTS / 2:.0f} can be modelled",
            "leave out those of little confidence, that the stack would not see either",
        )
    births = _births(log)
    places = np.stack([log.forward[births], -log.right[births]], axis=-1)
    spread = np.sqrt(places.std(axis=0).prod())  # one width for both directions
    width = float(spread * len(places) ** (-1 / 6))
    points = places[:: -(-len(places) // 200)]  # a model file keeps at most 200
    return MeasuredGhosts(rate, _persistence(log), points, width)


def describe_ghosts(ghosts: MeasuredGhosts | None, log: GhostLog | None, held_out: GhostLog | None) -> str:
    """Return a line for the terminal and the model card."""
    if log is None or held_out is None:
        return "false detections: none in the data (rows of `ghost` 1)"
    if ghosts is None:
        return (
            f"false detections: not fitted, {len(log.time)} in the training frames where {_LEAST} are needed"
        )
    lasting = f"lasting {ghosts.persistence:.2f} s" if ghosts.persistence else "none that lasts"
    return (
        f"false detections: {ghosts.rate:.3f} in a frame, {lasting}, from {len(log.time)} in "
        f"{len(log.frames)} frames; held out: {len(held_out.time)} seen in {len(held_out.frames)} frames, "
        f"{ghosts.rate * len(held_out.frames):.1f} expected"
    )


def _births(log: GhostLog) -> Bools:
    """Return a mask of the first row of each track, and of all rows without a track."""
    first = np.isnan(log.track)
    order = np.lexsort((log.time, log.track))
    track = log.track[order]
    begins = np.append(True, track[1:] != track[:-1])
    first[order[begins]] = True
    return np.asarray(first)


def _persistence(log: GhostLog) -> float:
    steps = np.diff(log.frames)
    frame = np.searchsorted(log.frames, log.time)
    tracked = np.isfinite(log.track) & (frame < len(steps))
    # 2.5 usual steps and more: the frames do not follow one another
    tracked[tracked] = steps[frame[tracked]] < 2.5 * np.median(steps) if len(steps) else False
    tracked_frames = set(zip(log.track.tolist(), frame.tolist(), strict=True))
    pairs = zip(log.track[tracked].tolist(), frame[tracked].tolist(), strict=True)
    stays = np.array([(track, at + 1) in tracked_frames for track, at in pairs], bool)
    if not stays.any():
        return 0.0
    frame_gap = steps[frame[tracked]]

    def loss(log_seconds: float) -> float:
        hazard = frame_gap / np.exp(log_seconds)
        return float(np.where(stays, hazard, -np.log(-np.expm1(-hazard))).sum())

    return float(np.exp(minimize_scalar(loss, bounds=(-5.0, 5.0), method="bounded").x))
