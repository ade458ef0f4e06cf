"""A car on a line, with the same outside as MetaDrive's process."""

import sys
from multiprocessing.connection import Connection

import numpy as np

from avrare_metadrive.config import SIGNALS
from avrare_metadrive.process import serve

GOAL = 3.0


class FakeEngine:
    def begin(self, config):
        self.lasers = config.lasers
        self.x, self.y = 0.0, 0.0
        return self.numbers()

    def step(self, steering, throttle):
        if steering > 0.9:
            raise ValueError("the steering wheel comes off")
        self.x += 0.5 * (1.0 + throttle)
        self.y += steering
        return self.numbers()

    def picture(self, width, height, scaling):
        self.x = -1.0  # a world must not notice that it is drawn
        return np.full((height, width, 3), 7, dtype=np.uint8)

    def numbers(self):
        found = dict.fromkeys(SIGNALS, 0.0) | {"x": self.x, "y": self.y, "arrived": self.x >= GOAL}
        found["over"] = found["arrived"]
        rays = 0.5 + 0.5 * np.sin(self.x + np.arange(self.lasers))
        return np.concatenate([[found[name] for name in SIGNALS], np.full(35, self.y), rays])


if __name__ == "__main__":
    serve(Connection(int(sys.argv[1])), FakeEngine())
