"""Tracks of vehicles in a log that has none: an annotated box keeps its size to the last digit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from avrare_pem_training.table import DetectionTable


def link_by_size(rows: DetectionTable, period: float) -> DetectionTable:
    """Return the rows with tracks: rows of one size, near one another in the log and on the road.

    A row continues the track of the last row of its size, unless that is ``_MOST_ROWS`` rows or ``_FARTHEST``
    metres away, or the same box again. Times count from the start of each track.

    Args:
        rows: Rows in the order of recording.
        period: Time between frames [s].
    """
    sizes = np.stack([rows.length, rows.width, rows.height], axis=1)
    _, size = np.unique(sizes, axis=0, return_inverse=True)
    order = np.argsort(size.reshape(-1), kind="stable")
    place = np.stack([rows.right, rows.forward, rows.yaw], axis=1)[order]
    way = np.hypot(*np.diff(place[:, :2], axis=0).T)
    most_rows = 80  # between two frames
    farthest = 20.0  # way between two frames, seen from the ego [m]
    continues = (np.diff(size.reshape(-1)[order]) == 0) & (np.diff(order) <= most_rows) & (way < farthest)
    continues &= (np.diff(place, axis=0) != 0).any(axis=1)
    begins = np.concatenate([[True], ~continues])
    number = np.cumsum(begins) - 1
    frame = np.arange(len(order)) - np.flatnonzero(begins)[number]
    track, time = np.empty(len(order)), np.empty(len(order))
    track[order], time[order] = number, period * frame
    return replace(rows, track=track, time=time)
