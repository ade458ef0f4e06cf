"""Tail atoms: a proposal that no score leads and that learns nothing.

A fault is often one number of the tape far in its tail, or a window of one channel whose sum is, at any time
and on any side: a component each, at depths that are even in the logarithm of the tail's probability. All
follow from the shape of the tape, so that no failure is hidden from them because nothing pointed to it.
"""

from __future__ import annotations

from functools import cache

from avrare_estimators.common.tapes.atoms import Row
from avrare_estimators.common.tapes.tape_mixture import TapeMixture

SHARE = 0.2
"""Share of the tail atoms in a proposal beside which something was learned."""
_START, _SINGLE, _WINDOW = 0.15, 0.5, 0.35
"""Shares of the numbers of the start, of those of later steps, and of windows."""


@cache
def tail_atoms(steps: int, channels: int) -> TapeMixture:
    """Return the mixture for tapes of this shape."""
    families = [(_START, [(0, 0)])]
    if steps:
        families.append((_SINGLE, [(t, t) for t in range(1, steps + 1)]))
    widths = [2**k for k in range(1, 7) if 2**k <= min(steps, 64)]
    for width in widths:
        windows = [(t, t + width - 1) for t in range(1, steps + 2 - width, max(1, width // 2))]
        families.append((_WINDOW / len(widths), windows))
    components: list[tuple[float, list[dict[Row, float]]]] = []
    shifts = (2.6, 3.7, 4.8)  # tail probabilities from 3e-2 to 1e-7, about even in their logarithm
    for share, windows in families:
        each = share / (len(windows) * channels * 2 * len(shifts))
        components += [
            (each, [{(channel, first, last, 1.0, 0.0, side * shift, 1.0): 1.0}])
            for first, last in windows
            for channel in range(channels)
            for shift in shifts
            for side in (-1.0, 1.0)
        ]
    return TapeMixture.of(components, (steps + 1, channels))


def with_tail_atoms(learned: TapeMixture) -> TapeMixture:
    """Return a proposal in which tail atoms have a share."""
    (rows, channels) = learned.shape
    atoms = tail_atoms(rows - 1, channels)
    parts = [((1.0 - SHARE), learned), (SHARE, atoms)]
    components = [(part * share, groups) for part, law in parts for share, groups in law.components]
    return TapeMixture.of(components, learned.shape, learned)
