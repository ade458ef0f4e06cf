"""Sequential problems of planners: hysteresis, modes, merging, occlusions, formulas with until."""

from __future__ import annotations

import math

import numpy as np
from scipy.special import ndtr
from scipy.stats import nbinom, norm

from . import exact
from .case import Case, Floats, State, threshold
from .exact import bell, mean, panels, survival


class IndecisivePlanner(Case):
    """A planner with hysteresis changes its mind about a lane change too often within 100 steps."""

    steps = 100
    noise_size = 1
    start = {"advantage": 0.0, "changes": False, "switches": 0}
    limit = 10
    formula = f"always (switches < {limit})"

    def step(self, state: State, noise: Floats) -> State:
        x = 0.85 * state["advantage"] + 0.5 * noise[:, 0]
        changes = np.where(state["changes"], x > -1.0, x > 1.0)
        return {
            "advantage": x,
            "changes": changes,
            "switches": state["switches"] + (changes != state["changes"]),
        }

    def exact(self) -> float:
        def density(x: Floats, before: Floats, _: int) -> Floats:
            return bell(x, 0.85 * before, 0.5)

        def label(count: int, x: Floats) -> Floats:
            switched = x <= -1.0 if count % 2 else x > 1.0  # an odd number of switches: it changes lanes
            return np.where(switched, count + 1 if count + 1 < self.limit else -1, count)

        grid = panels(-6.5, 6.5, 0.6, -1.0, 1.0)
        return 1 - survival(density, grid, 0.0, self.steps, np.eye(self.limit), label=label)[-1]


class EmergencyPlanner(Case):
    """A planner switches to emergency braking at 12 m and back at 16 m, and each mode has its own scatter."""

    steps = 60
    start = {"gap": 20.0, "emergency": False}
    level = -1.0
    formula = f"always (gap > {level})"

    def step(self, state: State, noise: Floats) -> State:
        gap, emergency = state["gap"], state["emergency"]
        calm, rough = gap + 0.1 * (20.0 - gap) + 1.3 * noise[:, 0], gap + 0.8 + 2.0 * noise[:, 0]
        gap = np.where(emergency, rough, calm)
        return {"gap": gap, "emergency": np.where(emergency, gap < 16.0, gap < 12.0)}

    def exact(self) -> float:
        def density(x: Floats, before: Floats, emergency: int) -> Floats:
            return bell(x, before + 0.8, 2.0) if emergency else bell(x, before + 0.1 * (20.0 - before), 1.3)

        def label(emergency: int, x: Floats) -> Floats:
            return (x < 16.0 if emergency else x < 12.0) * 1

        grid = panels(self.level, 50.0, 1.5, 12.0, 16.0)
        return 1 - survival(density, grid, 20.0, self.steps, np.eye(2), label=label)[-1]


class ImpatientMerge(Case):
    """A car on a ramp accepts ever smaller gaps, and measures one that is too small as large enough."""

    steps = 30
    noise_size = 2
    method = "quadrature"
    start = {"margin": 3.0, "merged": False, "t": 0}
    needed = 1.3
    formula = "always (margin > 0)"

    def step(self, state: State, noise: Floats) -> State:
        t = state["t"] + 1
        gap = 2.5 * np.exp(0.5 * noise[:, 0])
        accepts = ~state["merged"] & (gap * np.exp(0.3 * noise[:, 1]) > 9.0 * 0.93**t)
        return {
            "margin": np.where(accepts, gap - self.needed, 3.0),
            "merged": state["merged"] | accepts,
            "t": t,
        }

    def exact(self) -> float:
        failed, waiting = 0.0, 1.0
        small = math.log(self.needed / 2.5) / 0.5
        for t in range(1, self.steps + 1):
            least = math.log(9.0 * 0.93**t / 2.5)
            accepts = norm.sf(least / math.hypot(0.5, 0.3))
            failed += waiting * mean(
                lambda x, least=least: norm.sf((least - 0.5 * x) / 0.3) * (x < small), small
            )
            waiting *= 1 - accepts
        return float(failed)


class FirmwareSliver(Case):
    """A calibration value in a narrow band in the middle of its range is read wrongly and biases the steering."""

    steps = 40
    hidden = True
    start = {"x": 0.0, "biased": False}
    level, low, high = 2.7, 0.3, 0.3008
    formula = f"always (x < {level})"

    def initial(self, noise: Floats) -> State:
        return {"x": np.zeros(len(noise)), "biased": (noise[:, 0] > self.low) & (noise[:, 0] < self.high)}

    def step(self, state: State, noise: Floats) -> State:
        bias = np.where(state["biased"], 0.4, 0.0)
        return {"x": 0.8 * state["x"] + bias + 0.3 * noise[:, 0], "biased": state["biased"]}

    def exact(self) -> float:
        def density(x: Floats, before: Floats, biased: int) -> Floats:
            return bell(x, 0.8 * before + 0.4 * biased, 0.3)

        share = float(ndtr(self.high) - ndtr(self.low))
        grid = panels(-4.0, self.level, 0.3)
        return 1 - survival(density, grid, 0.0, self.steps, np.eye(2), (1 - share, share))[-1]


class BrakeUntilStop(Case):
    """A car has to keep its gap until it has stopped, which takes five stages of unknown length."""

    steps = 30
    noise_size = 2
    start = {"gap": 20.0, "stage": 0}
    formula = "(gap > 0) until[0:30 samples] (stage >= 5)"

    def step(self, state: State, noise: Floats) -> State:
        stage = state["stage"] + (noise[:, 1] > threshold(0.55))
        return {"gap": state["gap"] - 0.4 + 1.1 * noise[:, 0], "stage": stage}

    def exact(self) -> float:
        def density(x: Floats, before: Floats, _: int) -> Floats:
            return bell(x, before - 0.4, 1.1)

        safe = survival(density, panels(0.0, 60.0, 1.0), 20.0, self.steps)
        stops = nbinom.pmf(np.arange(self.steps + 1) - 5, 5, 0.55)
        return float(1 - (safe * stops).sum())


class OccludedChild(Case):
    """A child steps out from behind a van, at a moment when the car is too near and too fast to stop."""

    steps = 40
    noise_size = 1
    method = "quadrature"
    start = {"place": -60.0, "speed": 10.0, "clearance": 60.0}
    child = 2e-4
    formula = "always (clearance > 0)"

    def initial(self, noise: Floats) -> State:
        state = super().initial(noise)
        return {**state, "speed": 10.0 + 1.5 * noise[:, 0]}

    def step(self, state: State, noise: Floats) -> State:
        place, speed = state["place"] + 0.2 * state["speed"], state["speed"]
        clear = self.clearance(place, speed)
        return {
            "place": place,
            "speed": speed,
            "clearance": np.where(noise[:, 0] > threshold(self.child), clear, 60.0),
        }

    def clearance(self, place: Floats, speed: Floats) -> Floats:
        """Return what remains between a car that stops and the child [m]; 60 once it has passed."""
        return np.where(place < 0.0, -place - speed * np.abs(speed) / 12.0 - 0.3 * speed, 60.0)

    def exact(self) -> float:
        size = 20_000 * exact.ORDER
        share = (np.arange(size) + 0.5) / size
        speed = 10.0 + 1.5 * norm.ppf(share)
        times = np.arange(1, self.steps + 1)[:, None]
        near = sum(self.clearance(-60.0 + 0.2 * t * speed, speed) <= 0 for t in times)
        return float((1 - (1 - self.child) ** near).mean())
