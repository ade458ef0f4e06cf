"""Sequential problems of one or two continuous states, some with regimes."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np
from scipy.special import ndtr
from scipy.stats import chi2

from . import exact
from .case import Case, Floats, State, Values, switch
from .exact import bell, gauss, loss, panels

Move = tuple[Floats, Floats | float]


class Walk(Case):
    """A position x with Gaussian steps, which fails where it leaves an interval; a regime switches at random.

    Attributes:
        low: Lower end of the interval, or so low that the position never comes there.
        high: Upper end.
        enter: Probability a step to enter the regime.
        leave: Probability a step to leave it.
        share: Probability to start in it.
    """

    low: ClassVar[float]
    high: ClassVar[float]
    enter: ClassVar[float] = 0.0
    leave: ClassVar[float] = 0.0
    share: ClassVar[float] = 0.0
    start = {"x": 0.0, "regime": False}

    def move(self, x: Floats, regime: Values) -> Move:
        """Return the mean and scale of the next position."""
        raise NotImplementedError

    def step(self, state: State, noise: Floats) -> State:
        regime = switch(state["regime"], noise[:, -1], self.enter, self.leave)
        mean, scale = self.move(state["x"], regime)
        return {"x": mean + scale * noise[:, 0], "regime": regime}

    def exact(self) -> float:
        grid = panels(self.low, self.high, 0.1)
        switches = [[1 - self.enter, self.enter], [self.leave, 1 - self.leave]]
        shares = (1 - self.share, self.share)
        return loss(lambda x, was, k: bell(x, *self.move(was, k)), grid, self.steps, switches, shares)


class DropoutDrift(Walk):
    """A camera's lane detection drops out for a while, and the car drifts off its lane to either side."""

    steps, noise_size, low, high, enter, leave = 60, 2, -3.0, 3.0, 0.005, 0.15
    formula = f"always (x < {high} and x > {low})"

    def move(self, x: Floats, regime: Values) -> Move:
        return np.where(regime, x + 0.05, 0.7 * x), 0.2


class HiddenWear(Walk):
    """A brake begins to wear unseen, and from then on the stopping point scatters more."""

    steps, noise_size, low, high, enter = 60, 2, -8.0, 3.0, 0.0005
    formula = f"always (x < {high})"

    def move(self, x: Floats, regime: Values) -> Move:
        return 0.85 * x, np.where(regime, 0.5, 0.2)


class FollowGap(Case):
    """A follower's gap [m] and closing speed scatter, and its controller saturates."""

    steps, noise_size, level = 40, 2, 2.0
    start = {"gap": 20.0, "opening": 0.0}
    formula = f"always (gap > {level})"

    def means(self, gap: Floats, opening: Floats) -> tuple[Floats, Floats]:
        """Return the means of the next gap and opening speed."""
        return gap + 0.5 * opening, 0.6 * opening + np.clip(0.15 * (20.0 - gap), -1.0, 1.0)

    def step(self, state: State, noise: Floats) -> State:
        gap, opening = self.means(state["gap"], state["opening"])
        return {"gap": gap + 1.2 * noise[:, 0], "opening": opening + 1.2 * noise[:, 1]}

    def exact(self) -> float:
        gap, width = panels(self.level, 50.0, 3.6, 40 / 3, 80 / 3)
        opening, height = panels(-9.0, 9.0, 3.6)
        gap, opening = (axis.ravel() for axis in np.meshgrid(gap, opening, indexing="ij"))
        weights = np.outer(width, height).ravel()

        means = self.means(np.append(gap, 20.0), np.append(opening, 0.0))
        kernel = bell(gap[:, None], means[0], 1.2) * bell(opening[:, None], means[1], 1.2)
        kernel, part = kernel[:, :-1] * weights, kernel[:, -1]
        for _ in range(self.steps - 1):
            part = kernel @ part
        return float(1 - part @ weights)


class QuantisedFollow(Case):
    """A lateral controller sees its error in steps of half a metre only."""

    steps, noise_size, level, unit = 80, 2, 1.7, 0.5
    formula = f"always (x < {level})"

    def step(self, state: State, noise: Floats) -> State:
        seen = self.unit * np.round((state["x"] + 0.3 * noise[:, 1]) / self.unit)
        return {"x": state["x"] - 0.4 * seen + 0.25 * noise[:, 0]}

    def exact(self) -> float:
        def density(x: Floats, was: Floats, _: int) -> Floats:
            total = np.zeros(np.broadcast_shapes(np.shape(x), np.shape(was)))
            for seen in self.unit * np.arange(-10, 8):
                upper, lower = (ndtr((seen + half - was) / 0.3) for half in (self.unit / 2, -self.unit / 2))
                total += (upper - lower) * bell(x, was - 0.4 * seen, 0.25)
            return total

        return loss(density, panels(-3.5, self.level, 0.3), self.steps)


class SaturatedSteering(Walk):
    """Side wind pushes a van, and the steering that brings it back saturates."""

    steps, low, high = 80, -4.0, 2.6
    formula = f"always (x < {high})"

    def move(self, x: Floats, regime: Values) -> Move:
        return x + 0.03 - np.clip(0.5 * x, -0.2, 0.2), 0.25


class RangeNoise(Walk):
    """A range error feeds on itself: the farther the estimate is off, the larger the next error."""

    steps, low, high = 40, -4.0, 4.0
    formula = f"always (x < {high} and x > {low})"

    def move(self, x: Floats, regime: Values) -> Move:
        return 0.8 * x, 0.1 + 0.25 * np.abs(x)


class Gusts(Case):
    """A truck in gusts with heavy tails: one gust is enough to push it off its lane to either side."""

    steps, level = 50, 8.0
    formula = f"always (x < {level} and x > -{level})"

    def step(self, state: State, noise: Floats) -> State:
        low, high = ndtr(noise[:, 0]), ndtr(-noise[:, 0])
        return {"x": 0.85 * state["x"] + 0.02 * (low - high) / np.sqrt(2 * low * high)}

    def exact(self) -> float:
        edges = 0.06 * np.sinh(np.linspace(0.0, math.asinh(self.level / 0.06), 45))
        grid = gauss([*-edges, *edges, *np.linspace(-self.level, self.level, 300)])
        return loss(lambda x, was, _: (2 + ((x - 0.85 * was) / 0.02) ** 2) ** -1.5 / 0.02, grid, self.steps)


class BoundedGusts(Case):
    """Bounded gusts must blow the same way for long to push a car off its lane."""

    steps, level = 60, 0.62
    formula = f"always (x < {level})"

    def step(self, state: State, noise: Floats) -> State:
        return {"x": 0.9 * state["x"] + 0.1 * (2 * ndtr(noise[:, 0]) - 1)}

    def exact(self) -> float:
        x = np.linspace(-1.0, self.level, 5_000 * exact.ORDER + 1)
        safe = np.ones_like(x)
        for _ in range(self.steps):
            area = np.concatenate([[0.0], np.cumsum((safe[1:] + safe[:-1]) / 2 * np.diff(x))])
            ends = (np.interp(np.minimum(0.9 * x + gust, self.level), x, area) for gust in (0.1, -0.1))
            safe = (next(ends) - next(ends)) / 0.2
        return float(1 - np.interp(0.0, x, safe))


class ClutterEnergy(Case):
    """Twelve clutter returns a frame, none of them large, lift a filtered energy over its threshold."""

    steps, noise_size, level = 40, 12, 5.0
    formula = f"always (x < {level})"

    def step(self, state: State, noise: Floats) -> State:
        energy = ((noise**2).sum(axis=1) - 12.0) / math.sqrt(24.0)
        return {"x": 0.8 * state["x"] + 0.5 * energy}

    def exact(self) -> float:
        unit = 0.5 / math.sqrt(24.0)
        grid = panels(-5.0, self.level, 0.2)
        return loss(lambda x, was, _: chi2.pdf(12 + (x - 0.8 * was) / unit, 12) / unit, grid, self.steps)


class ClippedRisk(Walk):
    """A risk is reported as a share between 0 and 1, clipped at both ends."""

    steps, low, high = 50, -7.0, 4.6
    formula = "always (risk < 1)"

    def move(self, x: Floats, regime: Values) -> Move:
        return 0.9 * x, math.sqrt(0.19)

    def signals(self, state: State) -> State:
        return {"risk": np.clip((state["x"] - 2.6) / (self.high - 2.6), 0.0, 1.0)}


class DeceptiveOvertake(Walk):
    """The margin of an overtaking car grows with its speed until, too fast, it loses grip."""

    steps, low, high = 40, -10.0 / 3.0, 2.6 + 1.78 / 4.0
    formula = "always (margin > 0)"

    def move(self, x: Floats, regime: Values) -> Move:
        return 0.8 * x, 0.43

    def signals(self, state: State) -> State:
        return {"margin": np.minimum(1.0 + 0.3 * state["x"], 4.0 * (self.high - state["x"]))}


class Turbulence(Walk):
    """The strength of the wind wanders unseen, and strong wind must meet gusts to move the car."""

    steps, noise_size, low, high, persistence = 60, 2, -4.0, 4.0, 0.95
    formula = f"always (x < {high} and x > {low})"

    def initial(self, noise: Floats) -> State:
        return {"x": np.zeros(len(noise)), "wind": noise[:, 1]}

    def move(self, x: Floats, regime: Values) -> Move:
        return 0.8 * x, 0.1 * (1 + np.exp(0.7 * regime))

    def step(self, state: State, noise: Floats) -> State:
        wind = self.persistence * state["wind"] + math.sqrt(1 - self.persistence**2) * noise[:, 1]
        mean, scale = self.move(state["x"], wind)
        return {"x": mean + scale * noise[:, 0], "wind": wind}

    def exact(self) -> float:
        wind, weights = panels(-6.0, 6.0, 0.7)  # a regime each
        change = bell(wind, self.persistence * wind[:, None], math.sqrt(1 - self.persistence**2)) * weights
        grid, first = panels(self.low, self.high, 0.3), bell(wind) * weights
        return loss(lambda x, was, k: bell(x, *self.move(was, wind[k])), grid, self.steps, change, first)


class NearMiss(Case):
    """Three neighbours keep their places beside a car unevenly, and any of them may touch it."""

    steps, noise_size = 40, 6
    places = np.array([[6.3, 0.0], [-6.8, 0.5], [0.5, 5.2]])
    start = {"x": places[:, 0], "y": places[:, 1]}
    formula = "always (clearance > 0)"

    def step(self, state: State, noise: Floats) -> State:
        homes = zip(("x", "y"), self.places.T, (noise[:, :3], noise[:, 3:]), strict=True)
        return {key: home + 0.8 * (state[key] - home) + 0.6 * move for key, home, move in homes}

    def signals(self, state: State) -> State:
        apart = np.maximum(np.abs(state["x"]) - 2.0, np.abs(state["y"]) - 1.0)
        return {"clearance": apart.min(axis=1)}

    def exact(self) -> float:
        return float(1 - np.prod([self.survive(*home) for home in self.places]))

    def survive(self, along: float, across: float) -> float:
        """Return the probability that the neighbour of this place touches nothing."""
        (x, width), (y, height) = panels(-14.0, 14.0, 0.6, -2.0, 2.0), panels(-10.0, 10.0, 0.6, -1.0, 1.0)
        along_kernel = bell(x[:, None], along + 0.8 * (x - along), 0.6) * width
        across_kernel = bell(y[:, None], across + 0.8 * (y - across), 0.6) * height
        free = ~((np.abs(x)[:, None] < 2.0) & (np.abs(y) < 1.0))
        part = np.outer(bell(x, along, 0.6), bell(y, across, 0.6)) * free
        for _ in range(self.steps - 1):
            part = (along_kernel @ part @ across_kernel.T) * free
        return float(width @ part @ height)


class TwoOfThree(Case):
    """Each of three redundant sensors drifts until it is switched off for good; two of them are needed."""

    steps, noise_size, level = 50, 3, 3.3
    start = {"drift": np.zeros(3), "worst": np.zeros(3)}
    formula = f"always (second < {level})"

    def step(self, state: State, noise: Floats) -> State:
        drift = 0.95 * state["drift"] + math.sqrt(1 - 0.95**2) * noise
        return {"drift": drift, "worst": np.maximum(state["worst"], drift)}

    def signals(self, state: State) -> State:
        return {"second": np.sort(state["worst"], axis=1)[:, 1]}

    def exact(self) -> float:
        grid, scale = panels(-7.0, self.level, 0.35), math.sqrt(1 - 0.95**2)
        off = loss(lambda x, was, _: bell(x, 0.95 * was, scale), grid, self.steps)
        return 3 * off**2 * (1 - off) + off**3
