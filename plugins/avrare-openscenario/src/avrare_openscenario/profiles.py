"""Speeds that follow one another, with limited accelerations and jerks."""

from __future__ import annotations

import numpy as np

from avrare.protocols import Bools, Floats
from avrare_openscenario.story import SpeedProfile


def follow_profile(
    profile: SpeedProfile, table: Floats, start: Floats, slope: Floats, clock: Floats
) -> tuple[Floats, Bools]:
    """Return the speed (N,) at a time since the begin, and whether the last one is reached.

    Each speed is approached linearly, in its time or as fast as is allowed. Around each change of the
    acceleration the jerk is constant; the first one begins at the start, so that the line comes later.

    Args:
        profile: The action.
        table: (N, K) numbers of the file.
        start: (N,) speed at the begin [m/s].
        slope: (N,) acceleration there [m/s^2].
        clock: (N,) time since then [s].
    """
    change = np.diff(np.column_stack([start, table[:, list(profile.speeds)]]), axis=1)
    limits, sign = table[:, list(profile.limits)], np.where(change >= 0.0, 1.0, -1.0)
    most, jerk = (np.where(sign > 0.0, limits[:, [k]], limits[:, [k + 1]]) for k in (0, 2))
    with np.errstate(divide="ignore", invalid="ignore"):
        times = np.maximum(table[:, list(profile.durations)], np.abs(change) / most)
        if change.shape[1] == 1:  # the time includes the jerks
            lag, late = (
                0.5 * sign * (1.0 / limits[:, 2:3] + 1.0 / limits[:, 3:4]),
                slope[:, None] / (sign * jerk),
            )
            longer, wanted = times + late, change + 0.5 * late * slope[:, None]
            room = longer**2 - 4.0 * lag * wanted
            rate = 2.0 * wanted / (longer + np.sqrt(room))
            rate = np.where(room < 0.0, sign * np.sqrt(wanted / lag), rate)
            times = change / np.clip(rate, -most, most)
        slopes, times = np.nan_to_num(change / times), np.nan_to_num(times)
        steps = np.diff(np.column_stack([slope, slopes, np.zeros(len(slope))]), axis=1)
        reach = 0.5 * np.abs(steps) / np.where(steps >= 0.0, limits[:, 2:3], limits[:, 3:4])
        kinks = np.column_stack([reach[:, 0], np.cumsum(times, axis=1)])
        kinks[:, 1] -= np.nan_to_num(steps[:, 0] * reach[:, 0] / steps[:, 1])
        since = clock[:, None] - kinks
        bent = np.nan_to_num(np.maximum(reach - np.abs(since), 0.0) ** 2 / (4.0 * reach))
    value = start + slope * clock + (steps * (np.maximum(since, 0.0) + bent)).sum(axis=1)
    return value, clock >= kinks[:, -1] + reach[:, -1] - 1e-9
