"""Memory that this process may use, and amounts of it in words."""

from __future__ import annotations

import math
import os
from contextlib import suppress
from pathlib import Path

MOST_BY_DEFAULT = 2048.0
"""MiB that an estimate keeps to where its work can be divided."""
MEMORY_OPTION = (
    "MiB that the estimate may hold: its work is divided to keep this, and refused where that is not enough "
    "(default: divided to keep 2048; what cannot be divided may take more)"
)
"""Help of the option ``memory`` of every estimator."""


def allowance(memory: float | None) -> int:
    """Return the bytes to which the work of an estimate is cut, for its option ``memory`` [MiB]."""
    return int((MOST_BY_DEFAULT if memory is None else memory) * 2**20)


def usable_memory() -> float:
    """Return the bytes that this process may use in all: the least of machine, container and ``ulimit -v``.

    Infinite where all are unknown.
    """
    limits = [math.inf]
    with suppress(ImportError, OSError, ValueError):
        import resource  # not on Windows

        soft, _ = resource.getrlimit(resource.RLIMIT_AS)
        if soft != resource.RLIM_INFINITY:  # it counts what is reserved, used or not
            reserved, used = _sizes()
            limits.append(soft - reserved + used)
    with suppress(OSError, ValueError, AttributeError):
        limits.append(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    with suppress(OSError, ValueError):  # "max" is no number
        limits.append(int(Path("/sys/fs/cgroup/memory.max").read_text()))
    return float(min(limits))


def used_memory() -> int:
    """Return the bytes that this process uses now; 0 where it is unknown."""
    return _sizes()[1]


def _sizes() -> tuple[int, int]:
    # bytes reserved and used
    with suppress(OSError, ValueError, AttributeError):
        reserved, used = Path("/proc/self/statm").read_text().split()[:2]
        page = os.sysconf("SC_PAGE_SIZE")
        return int(reserved) * page, int(used) * page
    return 0, 0


def format_memory(amount: float) -> str:
    """Return bytes as ``3 MiB``, ``850 MiB`` or ``2.4 GiB``."""
    mebibytes = amount / 2**20
    if mebibytes >= 1000.0:
        return f"{mebibytes / 1024.0:.1f} GiB" if mebibytes < 102_400 else f"{mebibytes / 1024.0:,.0f} GiB"
    return f"{math.ceil(mebibytes)} MiB"
