"""Workers forked from the warm attack: a spawned one imports for a second of computing, to work for some ms.

What a worker does from its first chunk on is the same; kills reach it at work, and seldom at its imports.
"""

import contextlib
import multiprocessing
import os
import signal
import weakref
from multiprocessing.context import ForkContext, ForkProcess

_PARENTS_ENDS = weakref.WeakKeyDictionary()


class _Process(ForkProcess):
    """Worker without the signal handlers of the program that it is forked from."""

    def start(self):
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM})
        try:
            super().start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)

    def run(self):
        for number in (signal.SIGTERM, signal.SIGPROF, signal.SIGALRM):
            signal.signal(number, signal.SIG_DFL)
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.pthread_sigmask(signal.SIG_SETMASK, ())
        for connection, inode in list(
            _PARENTS_ENDS.items()
        ):  # or else others would not see the end of a pipe
            with contextlib.suppress(OSError):  # a thread of the parent was closing it when this was forked
                if os.fstat(connection.fileno()).st_ino == inode:
                    connection.close()
        super().run()


class _Context(ForkContext):
    Process = _Process

    def Pipe(self, duplex=True):
        ours, theirs = super().Pipe(duplex)
        _PARENTS_ENDS[ours] = os.fstat(ours.fileno()).st_ino
        return ours, theirs


def use():
    """Let this process fork its workers; for child processes of the attack."""
    context = _Context()
    multiprocessing.get_context = lambda method=None: context
