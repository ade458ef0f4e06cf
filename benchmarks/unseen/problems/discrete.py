"""Sequential problems of discrete states: faults, latches, queues, counters, codes."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from scipy.special import ndtr
from scipy.stats import norm

from .case import Case, Floats, State, Values, switch, threshold
from .exact import bell, loss, panels


class Chain(Case):
    """A chain of discrete states, whose steps only compare the noise with thresholds.

    Attributes:
        chances: Chances that the step compares each number of noise with.
    """

    chances: ClassVar[tuple[tuple[float, ...], ...]]

    def ends(self, state: State) -> Values:
        """Return which chains (N,) end."""
        raise NotImplementedError

    def exact(self) -> float:
        """Return the probability to end, by steps of every state under every cell of the noise."""
        cells, shares = np.zeros((1, 0)), np.ones(1)
        for chances in self.chances:
            edges = np.array([0.0, *sorted(chances), 1.0])
            middles = norm.isf((edges[1:] + edges[:-1]) / 2)[:, None]
            cells = np.hstack([np.repeat(cells, len(middles), 0), np.tile(middles, (len(cells), 1))])
            shares = np.outer(shares, np.diff(edges)).ravel()
        state, mass, ended = self.initial(cells[:1]), np.ones(1), 0.0
        for _ in range(self.steps):
            noise = np.tile(cells, (len(mass), 1))
            state = self.step({key: np.repeat(x, len(cells), 0) for key, x in state.items()}, noise)
            mass, ends = np.outer(mass, shares).ravel(), self.ends(state)
            ended += float(mass[ends].sum())
            table = np.column_stack([x[~ends] for x in state.values()])
            _, rows, index = np.unique(table, axis=0, return_index=True, return_inverse=True)
            state = {key: x[~ends][rows] for key, x in state.items()}
            mass = np.bincount(index.ravel(), mass[~ends])
        return ended


class LatchedBrake(Chain):
    """Four ghost detections in a row latch a brake, and eight steps later the car behind is there."""

    steps, chances = 60, ((0.002, 0.25),)
    start = {"run": 0, "timer": 0}
    formula = "always (timer < 8)"

    def step(self, state: State, noise: Floats) -> State:
        ghost = noise[:, 0] > np.where(state["run"] > 0, threshold(0.25), threshold(0.002))
        run = np.where(ghost, state["run"] + 1, 0)
        return {"run": run, "timer": state["timer"] + ((state["timer"] > 0) | (run >= 4))}

    def ends(self, state: State) -> Values:
        return state["timer"] >= 8


class ShortestQueue(Chain):
    """Cars join the shorter of two lanes at a toll station, and the queue reaches back into the motorway."""

    steps, noise_size, chances = 80, 3, ((0.2, 0.6), (0.5,), (0.5,))
    start = {"left": 0, "right": 0}
    formula = "always (left < 14 and right < 14)"

    def step(self, state: State, noise: Floats) -> State:
        left = np.maximum(state["left"] - (noise[:, 1] > 0.0), 0)
        right = np.maximum(state["right"] - (noise[:, 2] > 0.0), 0)
        for chance in (0.6, 0.2):
            arrives, joins_left = noise[:, 0] > threshold(chance), left <= right
            left, right = left + (arrives & joins_left), right + (arrives & ~joins_left)
        return {"left": left, "right": right}

    def ends(self, state: State) -> Values:
        return np.maximum(state["left"], state["right"]) >= 14


class MissWindow(Chain):
    """A tracker drops its track when five of the last ten detections are missing, in 100 steps."""

    steps, chances = 100, ((0.02,),)
    start = {"misses": np.zeros(10, bool)}
    formula = "always (count < 5)"

    def step(self, state: State, noise: Floats) -> State:
        return {"misses": np.hstack([state["misses"][:, 1:], noise > threshold(0.02)])}

    def signals(self, state: State) -> State:
        return {"count": state["misses"].sum(axis=1)}

    def ends(self, state: State) -> Values:
        return state["misses"].sum(axis=1) >= 5


class StartWhenClear(Chain):
    """A car may start after six clear frames in a row, which fog that stays may deny it for 60 frames."""

    steps, noise_size, chances = 60, 2, ((0.3, 0.9), (0.001, 0.03))
    start = {"run": 0, "fog": False}
    formula = "eventually (run >= 6)"

    def step(self, state: State, noise: Floats) -> State:
        fog = switch(state["fog"], noise[:, 1], 0.001, 0.03)
        clear = noise[:, 0] > np.where(fog, threshold(0.3), threshold(0.9))
        return {"run": np.where(clear, state["run"] + 1, 0), "fog": fog}

    def ends(self, state: State) -> Values:
        return state["run"] >= 6

    def exact(self) -> float:
        return 1 - super().exact()


class Redetect(Chain):
    """A lost pedestrian has to be seen again within eight frames, but a loss makes the next one likelier."""

    steps, chances = 58, ((0.02, 0.35),)
    start = {"lost": 0}
    formula = "always[0:50 samples] (seen < 0.5 -> eventually[0:8 samples] (seen > 0.5))"

    def step(self, state: State, noise: Floats) -> State:
        loses = noise[:, 0] > np.where(state["lost"] == 0, threshold(0.02), threshold(0.35))
        return {"lost": np.where(loses, state["lost"] + 1, 0)}

    def signals(self, state: State) -> State:
        return {"seen": state["lost"] == 0}

    def ends(self, state: State) -> Values:
        return state["lost"] >= 9


class PhantomBrake(Chain):
    """A car may brake only if there was a danger in the last six frames, but it brakes for ghosts."""

    steps, noise_size, chances = 60, 2, ((0.04,), (0.015, 0.9))
    start = {"since": 6, "count": 0}
    formula = "always (brake > 0.5 -> once[0:5 samples] (danger > 0.5))"

    def step(self, state: State, noise: Floats) -> State:
        danger = noise[:, 0] > threshold(0.04)
        detected = noise[:, 1] > np.where(danger, threshold(0.9), threshold(0.015))
        since = np.where(danger, 0, np.minimum(state["since"] + 1, 6))
        return {"since": since, "count": np.clip(state["count"] + np.where(detected, 1, -1), 0, 4)}

    def signals(self, state: State) -> State:
        return {"danger": state["since"] == 0, "brake": state["count"] >= 3}

    def ends(self, state: State) -> Values:
        return (state["count"] >= 3) & (state["since"] > 5)


class SlowLeak(Chain):
    """Brake fluid begins to leak, which nobody notices until an emergency stop asks for full pressure."""

    steps, noise_size, chances = 80, 2, ((1e-5,), (0.01,))
    start = {"age": 0, "demand": 0.2}
    formula = "always (pressure > demand)"

    def step(self, state: State, noise: Floats) -> State:
        leaks = (state["age"] > 0) | (noise[:, 0] > threshold(1e-5))
        demand = np.where(noise[:, 1] > threshold(0.01), 0.8, 0.2)
        return {"age": state["age"] + leaks, "demand": demand}

    def signals(self, state: State) -> State:
        return {"pressure": 1.0 - 0.015 * state["age"], "demand": state["demand"]}

    def ends(self, state: State) -> Values:
        return 1.0 - 0.015 * state["age"] <= state["demand"]


class Checksum(Chain):
    """A damaged message passes its check where the checksum of its frames happens to be the right one."""

    steps, hidden, chances = 12, True, (tuple(np.arange(1, 8) / 8),)
    start = {"sum": 1}
    edges = norm.ppf(np.arange(1, 8) / 8)
    formula = "always (passes < 0.5)"

    def step(self, state: State, noise: Floats) -> State:
        digit = np.searchsorted(self.edges, noise[:, 0])
        return {"sum": (state["sum"] * 31 + digit * 7_919 + 17) % 65_521}

    def signals(self, state: State) -> State:
        return {"passes": self.ends(state)}

    def ends(self, state: State) -> Values:
        return state["sum"] == 4_711


class QuietFrame(Case):
    """Six channels that are all near zero in one frame look like a dead sensor, and the car shuts down."""

    steps, noise_size, hidden = 30, 7, True
    start = {"drift": 0.0, "alive": True}
    quiet, level = 0.17, 4.9
    formula = f"always (alive > 0.5 and drift < {level})"

    def step(self, state: State, noise: Floats) -> State:
        alive = np.any(np.abs(noise[:, :6]) > self.quiet, axis=1)
        return {"drift": 0.9 * state["drift"] + 0.436 * noise[:, 6], "alive": alive}

    def exact(self) -> float:
        dead = (ndtr(self.quiet) - ndtr(-self.quiet)) ** 6
        grid = panels(-7.0, self.level, 0.5)
        drifts = loss(lambda x, was, _: bell(x, 0.9 * was, 0.436), grid, self.steps)
        return float(1 - (1 - dead) ** self.steps * (1 - drifts))


class GlareSequence(Case):
    """Glare, a late exposure seven frames on and a reset four frames after that blind a camera."""

    steps, noise_size, hidden, method = 40, 3, True, "closed form"
    start = {"glare": np.zeros(7, bool), "late": np.zeros(4, bool), "blind": False}
    low, high = 0.40, 0.46
    formula = "always (blind < 0.5)"

    def step(self, state: State, noise: Floats) -> State:
        inside = (noise > self.low) & (noise < self.high)
        glare, late = (np.hstack([state[key][:, 1:], inside[:, :1]]) for key in ("glare", "late"))
        late[:, -1] = inside[:, 1] & state["glare"][:, 0]
        return {"glare": glare, "late": late, "blind": inside[:, 2] & state["late"][:, 0]}

    def exact(self) -> float:
        inside = ndtr(self.high) - ndtr(self.low)
        return float(1 - (1 - inside**3) ** (self.steps - 11))
