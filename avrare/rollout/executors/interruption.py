"""Signal handling: the first Ctrl-C or SIGTERM stops after the current chunk, the second at once."""

from __future__ import annotations

import contextlib
import os
import signal
import threading
import time
from types import FrameType
from typing import Any


class Stopping:
    """Handler of Ctrl-C and SIGTERM while entered; calling it returns whether to stop.

    The second signal raises KeyboardInterrupt. An ignored signal (as in background jobs of a shell) stays
    ignored, and outside the main thread nothing is caught.

    Attributes:
        asked: True once a signal has arrived.
        silent: Print no note, because a live display shows it.
    """

    def __init__(self) -> None:
        self.asked = self.silent = False
        self._since = 0.0
        self._before: dict[signal.Signals, Any] = {}

    def __call__(self) -> bool:
        """Return True once a signal has arrived."""
        return self.asked

    def __enter__(self) -> Stopping:
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, signal.SIGTERM):
                if signal.getsignal(number) is not signal.SIG_IGN:
                    self._before[number] = signal.signal(number, self._handle)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)
        self._before = {}

    def _handle(self, number: int, frame: FrameType | None) -> None:
        now = time.monotonic()
        if self.asked:
            if now - self._since < 0.2:  # ``timeout`` signals a program and its group: both count as one
                return
            raise KeyboardInterrupt
        self.asked, self._since = True, now
        if not self.silent:
            with contextlib.suppress(OSError):  # not print, which the signal may have interrupted
                os.write(2, b"\nstopping after the current chunk; press Ctrl-C again to stop at once\n")
