"""Systems that actors can import."""

import os
from pathlib import Path

from avrare.testing import systems


class Fatal(systems.Walk):
    """Takes its process with it while a file is there, which it removes, or every time."""

    def __init__(self, trap=None):
        super().__init__()
        self.trap = trap

    def step(self, state, noise):
        if os.getpid() != getattr(self, "home", None):
            try:
                if self.trap is None:
                    os._exit(1)
                Path(self.trap).unlink()
                os._exit(1)
            except FileNotFoundError:
                pass
        return super().step(state, noise)
