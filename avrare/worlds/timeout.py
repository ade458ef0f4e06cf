"""A limit on how long one step of a world may take: what hangs becomes an error of its rollout."""

from __future__ import annotations

import signal
import threading
from types import FrameType, TracebackType
from typing import Any

from avrare.errors import UsageError


class StepTimeout(Exception):
    """A step that took longer than allowed."""


class _Alarm(BaseException):
    """Not an ``Exception``: the world's own handlers must not swallow it."""


class Watch:
    """Interrupts what takes too long, by SIGALRM; entered around many steps, ``call`` guards one.

    Args:
        seconds: Wall-clock limit of one call; None: no limit.
    """

    def __init__(self, seconds: float | None) -> None:
        self.seconds = seconds
        self._armed = False
        self._before: tuple[Any, tuple[float, float]] | None = None

    def __enter__(self) -> Watch:
        if self.seconds is not None:
            if threading.current_thread() is not threading.main_thread() or not hasattr(signal, "SIGALRM"):
                raise UsageError(
                    "step_timeout needs the main thread of a process on a Unix system",
                    "leave step_timeout out, or use more workers",
                )
            timer = signal.getitimer(signal.ITIMER_REAL)
            self._before = signal.signal(signal.SIGALRM, self._ring), timer
        return self

    def __exit__(self, kind: type[BaseException] | None, error: Any, trace: TracebackType | None) -> None:
        if self._before is not None:
            handler, timer = self._before
            signal.signal(signal.SIGALRM, handler)
            signal.setitimer(signal.ITIMER_REAL, *timer)
            self._before = None

    def call(self, function: Any, *arguments: Any) -> Any:
        """``function(*arguments)``, if it ends in time.

        Raises:
            StepTimeout: It does not.
        """
        if self.seconds is None:
            return function(*arguments)
        try:
            try:
                self._armed = True
                # Again and again: something in there may catch everything.
                signal.setitimer(signal.ITIMER_REAL, self.seconds, self.seconds)
                return function(*arguments)
            finally:
                self._disarm()
        except _Alarm:
            self._disarm()  # it may have rung in the `finally`
            raise StepTimeout(f"no end after {self.seconds:g} s") from None

    def _disarm(self) -> None:
        self._armed = False
        signal.setitimer(signal.ITIMER_REAL, 0.0)

    def _ring(self, number: int, frame: FrameType | None) -> None:
        if self._armed:
            raise _Alarm
