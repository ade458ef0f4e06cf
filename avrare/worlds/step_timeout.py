"""Time limit of a step of a world: a step that hangs becomes an error of its rollout."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable
from typing import Any, TypeVar

from avrare.base.errors import UsageError

Answer = TypeVar("Answer")


class StepTimeout(Exception):
    """Step that exceeded the time limit."""


class _Alarm(BaseException):
    """Alarm: not an ``Exception``, so that the world's own handlers do not catch it."""


class Watchdog:
    """Watchdog that interrupts calls slower than ``seconds`` by SIGALRM, where there is a limit.

    It is entered around many steps; ``call`` guards one.
    """

    def __init__(self, seconds: float | None) -> None:
        self.seconds = seconds
        self._armed = False
        self._before: tuple[Any, tuple[float, float]] | None = None

    def __enter__(self) -> Watchdog:
        if self.seconds is not None:
            if threading.current_thread() is not threading.main_thread() or not hasattr(signal, "SIGALRM"):
                raise UsageError(
                    "step_timeout needs the main thread of a process on a Unix system",
                    "remove step_timeout, or use more workers",
                )
            timer = signal.getitimer(signal.ITIMER_REAL)
            self._before = signal.signal(signal.SIGALRM, self._on_alarm), timer
        return self

    def __exit__(self, *_: object) -> None:
        if self._before is not None:
            handler, timer = self._before
            signal.signal(signal.SIGALRM, handler)
            signal.setitimer(signal.ITIMER_REAL, *timer)
            self._before = None

    def call(self, function: Callable[..., Answer], *arguments: object) -> Answer:
        """Call ``function(*arguments)`` under the time limit, or raise ``StepTimeout``."""
        if self.seconds is None:
            return function(*arguments)
        try:
            try:
                self._armed = True
                # Repeatedly: the function may catch the first alarm.
                signal.setitimer(signal.ITIMER_REAL, self.seconds, self.seconds)
                return function(*arguments)
            finally:
                self._disarm()
        except _Alarm:
            self._disarm()  # it may have fired in the `finally`
            raise StepTimeout(f"the step did not end within {self.seconds:g} s") from None

    def _disarm(self) -> None:
        self._armed = False
        signal.setitimer(signal.ITIMER_REAL, 0.0)

    def _on_alarm(self, *_: object) -> None:
        if self._armed:
            raise _Alarm
