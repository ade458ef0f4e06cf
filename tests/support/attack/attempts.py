"""One call of the command line in this process, under watch, and what may be wrong with its end."""

import contextlib
import io
import os
import resource
import signal
import warnings
from collections import Counter
from dataclasses import dataclass

from avrare.cli.main import main

LONGEST = 20.0
"""Seconds of computing after which a call is said to hang."""
MEMORY = 6 * 2**30
"""Bytes that a call may take."""
CODES = {
    "run": {0, 4, 5, 6},
    "check": {0, 1, 3, 4, 5, 6},
    "monitor": {0, 1, 4, 5},
    "rate": {0, 1, 3, 4, 5, 6},
    "require": {0, 3, 4, 5, 6},
    "why": {0, 4, 5, 6},
    "sensitivity": {0, 4, 5, 6},
    "falsify": {0, 1, 4, 5, 6},
    "replay": {0, 1, 4, 5},
    "scenes": {0, 1, 4, 5},
    "plugins": {0, 1, 4, 5},
}
"""Command -> exit codes that an input may lead to; of all others 0, 4, 5."""
TRACEBACK, HANG, CODE, OUTPUT, BITS = (
    "tracebacks",
    "hangs",
    "wrong exit codes",
    "unclean output",
    "other bits",
)
TROUBLES = (TRACEBACK, HANG, CODE, OUTPUT, BITS)
_REFUSED = {4, 5}


class Hang(BaseException):
    """A call that computes for too long; no ``except Exception`` keeps it."""


@dataclass(frozen=True)
class Outcome:
    """End of a call: exit code, what it printed, and the exception that got through, if any."""

    words: tuple[str, ...]
    code: int | None
    out: str
    err: str
    escaped: BaseException | None = None

    def told(self) -> str:
        """Return the call and the end of what it said, in one paragraph."""
        end = self.err[-1500:] if self.escaped is None else repr(self.escaped)[:1500]
        return f"avrare {' '.join(map(repr, self.words))}"[:1000] + f"\nexit code {self.code}\n{end}"


def call(words):
    """Run a command in this process; its standard input is empty."""
    out, err = io.StringIO(), io.StringIO()
    code = escaped = None
    with watched(), contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            code = main(list(words))
        except (Exception, SystemExit, KeyboardInterrupt, Hang) as error:
            escaped = error
    return Outcome(tuple(words), code, out.getvalue(), err.getvalue(), escaped)


@contextlib.contextmanager
def watched(seconds=LONGEST):
    """Raises ``Hang`` in what computes, or waits, for too long."""

    def stop(number, _):
        raise Hang("it waits" if number == signal.SIGALRM else "it computes")

    before = [signal.signal(number, stop) for number in (signal.SIGPROF, signal.SIGALRM)]
    signal.setitimer(signal.ITIMER_PROF, seconds)
    signal.setitimer(signal.ITIMER_REAL, 6 * seconds)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        for number, handler in zip((signal.SIGPROF, signal.SIGALRM), before, strict=True):
            signal.signal(number, handler)


def limit_memory():
    """Make what takes too much memory a MemoryError, as on a small machine; for child processes."""
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    os.environ["BROWSER"] = "true"


def trouble(outcome):
    """Name what is wrong with an outcome, one of ``TROUBLES``; None: nothing."""
    text = outcome.out + outcome.err
    if isinstance(outcome.escaped, Hang):
        return HANG
    if outcome.escaped is not None or outcome.code == 70 or "Traceback (most recent" in text:
        return TRACEBACK
    if outcome.code not in CODES.get(_command(outcome.words), {0, 4, 5}):
        return CODE
    if outcome.code in _REFUSED and not outcome.err.strip():
        return CODE
    return OUTPUT if any(sign in text for sign in "\x1b\x07\x9b\u202e") else None


def _command(words):
    return next((word for word in words if not word.startswith("-")), "")


def count(troubles):
    """Return how often each kind of trouble occurred."""
    return Counter(one for one in troubles if one)
