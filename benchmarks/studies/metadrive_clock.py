"""MetaDrive's engine with a clock: the CPU time of all processes that were forked from one.

The operating system does not add it up, since nobody waits for the copies. The processes of one root run in
turn, so that a number in memory that they share needs no lock.
"""

from __future__ import annotations

import os
import struct
import sys
import time
from mmap import mmap
from multiprocessing.connection import Connection
from typing import Any

from avrare.protocols import Floats
from avrare_metadrive.engine import Engine
from avrare_metadrive.process import serve

_NUMBER = struct.Struct("d")


class ClockedEngine(Engine):
    """Engine that counts what it and its copies spend, forking included."""

    def __init__(self) -> None:
        super().__init__()
        self._shared = mmap(-1, _NUMBER.size)
        self._counted = 0, 0.0  # process, and what of its time is counted

    def step(self, *action: Any) -> Floats:
        """Advance; see ``Engine``."""
        numbers = super().step(*action)
        self.seconds()
        return numbers

    def seconds(self) -> float:
        """Return the CPU time [s] of all processes until now."""
        process, counted = self._counted
        spent = time.process_time()
        counted = counted if process == os.getpid() else 0.0
        (total,) = _NUMBER.unpack(self._shared[:])
        self._shared[:] = _NUMBER.pack(total + spent - counted)
        self._counted = os.getpid(), spent
        return float(total + spent - counted)


if __name__ == "__main__":
    serve(Connection(int(sys.argv[1])), ClockedEngine())
