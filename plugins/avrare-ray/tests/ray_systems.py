"""Systems that actors can import."""

import os
import signal
import time
from pathlib import Path

import numpy as np

from avrare.testing import faulty_systems as systems


class Fatal(systems.Walk):
    """Takes its process with it at a sample, while a file is there, which it removes, or every time."""

    def __init__(self, sample, trap=None):
        super().__init__()
        self.sample, self.trap = sample, trap

    def initial(self, noise):
        return {**super().initial(noise), "t": np.zeros(len(noise))}

    def step(self, state, noise):
        if state["t"][0] + 1 == self.sample and (self.trap is None or _taken(self.trap)):
            os._exit(1)
        return {**super().step(state, noise), "t": state["t"] + 1}


class Native(systems.Fragile):
    """Ends its process, or hangs, in about one rollout of a hundred; or raises there."""

    def __init__(self, end):
        super().__init__("raise", 3.3)
        self.end = end

    def _state(self, x, noise, now):
        if now and (noise[:, 1] > self.beyond).any():
            {"dies": lambda: os.kill(os.getpid(), signal.SIGSEGV), "hangs": _hang, "raises": int}[self.end]()
        return super()._state(x, noise, now)


def _hang():
    while True:
        time.sleep(1.0)


def _taken(trap):
    """Remove a file; return whether it was there: of several processes one alone can take it away."""
    try:
        Path(trap).unlink()
    except FileNotFoundError:
        return False
    return True
