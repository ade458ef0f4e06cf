"""Deferral of signals while a solver runs."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def defer_signals() -> Iterator[None]:
    """Defer signals that Python handles until the end of the block.

    CasADi polls them during a solve and treats an exception from a handler as a failed solve: Ctrl-C would be
    lost, and the rollout would continue with another plan. Outside the main thread no handler runs.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    deferred: list[int] = []
    signals = (signal.SIGINT, signal.SIGTERM)
    handlers = {number: handler for number in signals if callable(handler := signal.getsignal(number))}
    for number in handlers:
        signal.signal(number, lambda number, _: deferred.append(number))
    try:
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        for caught in deferred:
            signal.raise_signal(caught)
