"""Ctrl-C and SIGTERM: first a request to stop after the chunk in hand, the second time at once."""

from __future__ import annotations

import contextlib
import os
import signal
import threading
import time
from types import FrameType
from typing import Any

_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_NOTE = b"\nstopping after the chunk in hand; once more to leave at once\n"
_ECHO = 0.2
"""Seconds in which a second signal is the first one still: ``timeout`` signals a program and its group."""


class Stopping:
    """While entered, catches the signals that ask for an end; calling it tells whether one came.

    The second one raises KeyboardInterrupt. A signal that is ignored (as of background jobs of a shell) stays
    so, and outside the main thread nothing is caught.

    Attributes:
        asked: Whether one came.
        silent: Somebody else says so: a note in the midst of a live display would break it.
    """

    def __init__(self) -> None:
        self.asked = self.silent = False
        self._since = 0.0
        self._before: dict[signal.Signals, Any] = {}

    def __call__(self) -> bool:
        """Whether to stop."""
        return self.asked

    def __enter__(self) -> Stopping:
        if threading.current_thread() is threading.main_thread():
            for number in _SIGNALS:
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
            if now - self._since < _ECHO:
                return
            raise KeyboardInterrupt
        self.asked, self._since = True, now
        if not self.silent:
            with contextlib.suppress(OSError):  # not print: the signal may have come in the midst of one
                os.write(2, _NOTE)
