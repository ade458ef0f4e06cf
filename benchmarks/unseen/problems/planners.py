"""Sequential problems of planners: hysteresis, modes, merging, occlusions, formulas with until."""

from __future__ import annotations

import math

import numpy as np
from scipy.special import ndtr
from scipy.stats import nbinom, norm

from . import exact
from .case import Case, Floats, State, Values, threshold
from .continuous import Move, Walk
from .exact import bell, loss, panels, survival


class IndecisivePlanner(Case):
    """A planner with hysteresis changes its mind about a lane change too often within 100 steps."""

    steps, limit = 100, 10
    start = {"advantage": 0.0, "changes": False, "switches": 0}
    formula = f"always (switches < {limit})"

    def step(self, state: State, noise: Floats) -> State:
        x = 0.85 * state["advantage"] + 0.5 * noise[:, 0]
        changes = np.where(state["changes"], x > -1.0, x > 1.0)
        switches = state["switches"] + (changes != state["changes"])
        return {"advantage": x, "changes": changes, "switches": switches}

    def exact(self) -> float:
        def label(count: int, x: Floats) -> Floats:
            switched = x <= -1.0 if count % 2 else x > 1.0  # an odd number of switches: it changes lanes
            return np.where(switched, count + 1 if count + 1 < self.limit else -1, count)

        grid = panels(-6.5, 6.5, 0.6, -1.0, 1.0)
        kernel, counts = lambda x, was, _: bell(x, 0.85 * was, 0.5), np.eye(self.limit)
        return loss(kernel, grid, self.steps, counts, label=label)


class EmergencyPlanner(Walk):
    """A planner switches to emergency braking at 12 m and back at 16 m, and each mode has its own scatter."""

    steps, low, high = 60, -1.0, 50.0
    start = {"x": 20.0, "regime": False}
    formula = f"always (x > {low})"

    def move(self, x: Floats, regime: Values) -> Move:
        return np.where(regime, x + 0.8, 0.9 * x + 2.0), np.where(regime, 2.0, 1.3)

    def step(self, state: State, noise: Floats) -> State:
        mean, scale = self.move(state["x"], state["regime"])
        x = mean + scale * noise[:, 0]
        return {"x": x, "regime": np.where(state["regime"], x < 16.0, x < 12.0)}

    def exact(self) -> float:
        grid = panels(self.low, self.high, 1.5, 12.0, 16.0)
        density, label = lambda x, was, k: bell(x, *self.move(was, k)), lambda k, x: x < (12.0, 16.0)[k]
        return loss(density, grid, self.steps, np.eye(2), label=label, start=20.0)


class ImpatientMerge(Case):
    """A car on a ramp accepts ever smaller gaps, and measures one that is too small as large enough."""

    steps, noise_size, method, needed = 30, 2, "quadrature", 1.3
    start = {"margin": 3.0, "merged": False, "t": 0}
    formula = "always (margin > 0)"

    def step(self, state: State, noise: Floats) -> State:
        t, gap = state["t"] + 1, 2.5 * np.exp(0.5 * noise[:, 0])
        accepts = ~state["merged"] & (gap * np.exp(0.3 * noise[:, 1]) > 9.0 * 0.93**t)
        margin = np.where(accepts, gap - self.needed, 3.0)
        return {"margin": margin, "merged": state["merged"] | accepts, "t": t}

    def exact(self) -> float:
        failed, waiting = 0.0, 1.0
        x, weights = panels(-9.0, math.log(self.needed / 2.5) / 0.5, 0.1)
        for t in range(1, self.steps + 1):
            least = math.log(9.0 * 0.93**t / 2.5)
            failed += waiting * (norm.sf((least - 0.5 * x) / 0.3) * bell(x) * weights).sum()
            waiting *= norm.cdf(least / math.hypot(0.5, 0.3))
        return float(failed)


class FirmwareSliver(Walk):
    """A calibration value in a narrow band in the middle of its range is misread and biases the steering."""

    steps, hidden, low, high = 40, True, -4.0, 2.7
    band = (0.3, 0.3008)
    share = float(ndtr(band[1]) - ndtr(band[0]))
    formula = f"always (x < {high})"

    def initial(self, noise: Floats) -> State:
        value = noise[:, 0]
        return {"x": np.zeros(len(noise)), "regime": (value > self.band[0]) & (value < self.band[1])}

    def move(self, x: Floats, regime: Values) -> Move:
        return 0.8 * x + 0.4 * regime, 0.3


class BrakeUntilStop(Case):
    """A car has to keep its gap until it has stopped, which takes five stages of unknown length."""

    steps, noise_size = 30, 2
    start = {"gap": 20.0, "stage": 0}
    formula = "(gap > 0) until[0:30 samples] (stage >= 5)"

    def step(self, state: State, noise: Floats) -> State:
        stage = state["stage"] + (noise[:, 1] > threshold(0.55))
        return {"gap": state["gap"] - 0.4 + 1.1 * noise[:, 0], "stage": stage}

    def exact(self) -> float:
        grid = panels(0.0, 60.0, 1.0)
        safe = survival(lambda x, was, _: bell(x, was - 0.4, 1.1), grid, self.steps, start=20.0)
        stops = nbinom.pmf(np.arange(self.steps + 1) - 5, 5, 0.55)
        return float(1 - (safe * stops).sum())


class OccludedChild(Case):
    """A child steps out from behind a van, at a moment when the car is too near and too fast to stop."""

    steps, method, child = 40, "quadrature", 2e-4
    start = {"place": -60.0, "speed": 10.0, "clearance": 60.0}
    formula = "always (clearance > 0)"

    def initial(self, noise: Floats) -> State:
        return {**super().initial(noise), "speed": 10.0 + 1.5 * noise[:, 0]}

    def step(self, state: State, noise: Floats) -> State:
        place, speed = state["place"] + 0.2 * state["speed"], state["speed"]
        appears = noise[:, 0] > threshold(self.child)
        clear = np.where(appears, self.clearance(place, speed), 60.0)
        return {"place": place, "speed": speed, "clearance": clear}

    def clearance(self, place: Floats, speed: Floats) -> Floats:
        """Return what remains between a car that stops and the child [m]; 60 once it has passed."""
        return np.where(place < 0.0, -place - speed * np.abs(speed) / 12.0 - 0.3 * speed, 60.0)

    def exact(self) -> float:
        size = 20_000 * exact.ORDER
        speed = 10.0 + 1.5 * norm.ppf((np.arange(size) + 0.5) / size)
        times = np.arange(1, self.steps + 1)[:, None]
        near = sum(self.clearance(-60.0 + 0.2 * t * speed, speed) <= 0 for t in times)
        return float((1 - (1 - self.child) ** near).mean())
