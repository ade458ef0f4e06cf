"""Systems that actors can import."""

import os
from pathlib import Path

from avrare.testing import faulty_systems as systems


class Fatal(systems.Walk):
    """Takes its process with it while a file is there, which it removes, or every time."""

    def __init__(self, trap=None):
        super().__init__()
        self.trap = trap

    def step(self, state, noise):
        if os.getpid() != getattr(self, "home", None) and (self.trap is None or _taken(self.trap)):
            os._exit(1)
        return super().step(state, noise)


class Nameless(systems.Walk):
    """Walk without the signal ``x`` that the formulas read."""

    def signals(self, state):
        return {"y": state["x"]}


def _taken(trap):
    """Remove a file; return whether it was there: of several processes one alone can take it away."""
    try:
        Path(trap).unlink()
    except FileNotFoundError:
        return False
    return True
