"""Sequential problems of one or two continuous states, some with regimes."""

from __future__ import annotations

import math

import numpy as np
from scipy.special import ndtr
from scipy.stats import chi2

from . import exact
from .case import Case, Floats, State, switch
from .exact import bell, gauss, panels, survival


class DropoutDrift(Case):
    """A camera's lane detection drops out for a while, and the car drifts off its lane to either side."""

    steps = 60
    noise_size = 2
    start = {"x": 0.0, "out": False}
    level, enter, leave = 3.0, 0.005, 0.15
    formula = f"always (x < {level} and x > -{level})"

    def step(self, state: State, noise: Floats) -> State:
        out = switch(state["out"], noise[:, 1], self.enter, self.leave)
        return {"x": np.where(out, state["x"] + 0.05, 0.7 * state["x"]) + 0.2 * noise[:, 0], "out": out}

    def exact(self) -> float:
        def density(x: Floats, before: Floats, out: int) -> Floats:
            return bell(x, before + 0.05 if out else 0.7 * before, 0.2)

        switches = [[1 - self.enter, self.enter], [self.leave, 1 - self.leave]]
        return 1 - survival(density, panels(-self.level, self.level, 0.3), 0.0, self.steps, switches)[-1]


class HiddenWear(Case):
    """A brake begins to wear unseen, and from then on the stopping point scatters two and a half times more."""

    steps = 60
    noise_size = 2
    start = {"x": 0.0, "worn": False}
    level, wear = 3.0, 0.0005
    formula = f"always (x < {level})"

    def step(self, state: State, noise: Floats) -> State:
        worn = switch(state["worn"], noise[:, 1], self.wear, 0.0)
        return {"x": 0.85 * state["x"] + np.where(worn, 0.5, 0.2) * noise[:, 0], "worn": worn}

    def exact(self) -> float:
        def density(x: Floats, before: Floats, worn: int) -> Floats:
            return bell(x, 0.85 * before, (0.2, 0.5)[worn])

        switches = [[1 - self.wear, self.wear], [0.0, 1.0]]
        return 1 - survival(density, panels(-8.0, self.level, 0.3), 0.0, self.steps, switches)[-1]


class FollowGap(Case):
    """A follower's gap [m] and closing speed scatter, and its controller saturates."""

    steps = 40
    noise_size = 2
    start = {"gap": 20.0, "opening": 0.0}
    level = 2.0
    formula = f"always (gap > {level})"

    def means(self, gap: Floats, opening: Floats) -> tuple[Floats, Floats]:
        """Return the means of the next gap and opening speed."""
        return gap + 0.5 * opening, 0.6 * opening + np.clip(0.15 * (20.0 - gap), -1.0, 1.0)

    def step(self, state: State, noise: Floats) -> State:
        gap, opening = self.means(state["gap"], state["opening"])
        return {"gap": gap + 1.2 * noise[:, 0], "opening": opening + 1.2 * noise[:, 1]}

    def exact(self) -> float:
        (gap, width), (opening, height) = (
            panels(self.level, 50.0, 3.6, 40 / 3, 80 / 3),
            panels(-9.0, 9.0, 3.6),
        )
        gap, opening = (axis.ravel() for axis in np.meshgrid(gap, opening, indexing="ij"))
        weights = np.outer(width, height).ravel()

        def density(gap_before: Floats, opening_before: Floats) -> Floats:
            gap_mean, opening_mean = self.means(gap_before, opening_before)
            return bell(gap[:, None], gap_mean, 1.2) * bell(opening[:, None], opening_mean, 1.2)

        kernel = density(gap, opening) * weights
        part = density(np.array([20.0]), np.array([0.0]))[:, 0]
        for _ in range(self.steps - 1):
            part = kernel @ part
        return float(1 - part @ weights)


class QuantisedFollow(Case):
    """A lateral controller sees its error in steps of half a metre only."""

    steps = 80
    noise_size = 2
    level, unit = 1.7, 0.5
    formula = f"always (x < {level})"

    def step(self, state: State, noise: Floats) -> State:
        seen = self.unit * np.round((state["x"] + 0.3 * noise[:, 1]) / self.unit)
        return {"x": state["x"] - 0.4 * seen + 0.25 * noise[:, 0]}

    def exact(self) -> float:
        def density(x: Floats, before: Floats, _: int) -> Floats:
            total = np.zeros(np.broadcast_shapes(np.shape(x), np.shape(before)))
            for seen in self.unit * np.arange(-10, 8):
                upper, lower = (seen + half - before for half in (self.unit / 2, -self.unit / 2))
                total += (ndtr(upper / 0.3) - ndtr(lower / 0.3)) * bell(x, before - 0.4 * seen, 0.25)
            return total

        return 1 - survival(density, panels(-3.5, self.level, 0.3), 0.0, self.steps)[-1]


class SaturatedSteering(Case):
    """Side wind pushes a van, and the steering that brings it back saturates."""

    steps = 80
    level = 2.6
    formula = f"always (x < {level})"

    def step(self, state: State, noise: Floats) -> State:
        x = state["x"]
        return {"x": x + 0.03 - np.clip(0.5 * x, -0.2, 0.2) + 0.25 * noise[:, 0]}

    def exact(self) -> float:
        def density(x: Floats, before: Floats, _: int) -> Floats:
            return bell(x, before + 0.03 - np.clip(0.5 * before, -0.2, 0.2), 0.25)

        grid = panels(-4.0, self.level, 0.3, -0.4, 0.4)
        return 1 - survival(density, grid, 0.0, self.steps)[-1]


class RangeNoise(Case):
    """A range error feeds on itself: the farther the estimate is off, the larger the next error."""

    steps = 40
    level = 4.0
    formula = f"always (x < {level} and x > -{level})"

    def step(self, state: State, noise: Floats) -> State:
        return {"x": 0.8 * state["x"] + (0.1 + 0.25 * np.abs(state["x"])) * noise[:, 0]}

    def exact(self) -> float:
        def density(x: Floats, before: Floats, _: int) -> Floats:
            return bell(x, 0.8 * before, 0.1 + 0.25 * np.abs(before))

        edges = 0.4 * (np.geomspace(1.0, self.level / 0.4 + 1.0, 30) - 1.0)
        return 1 - survival(density, gauss([*-edges, *edges]), 0.0, self.steps)[-1]


class Gusts(Case):
    """A truck in gusts with heavy tails: one gust is enough to push it off its lane to either side."""

    steps = 50
    level = 8.0
    formula = f"always (x < {level} and x > -{level})"

    def step(self, state: State, noise: Floats) -> State:
        low, high = ndtr(noise[:, 0]), ndtr(-noise[:, 0])
        return {"x": 0.85 * state["x"] + 0.02 * (low - high) / np.sqrt(2 * low * high)}

    def exact(self) -> float:
        def density(x: Floats, before: Floats, _: int) -> Floats:
            return (2 + ((x - 0.85 * before) / 0.02) ** 2) ** -1.5 / 0.02  # Student's with two degrees

        edges = 0.06 * np.sinh(np.linspace(0.0, math.asinh(self.level / 0.06), 45))
        fine = np.linspace(-self.level, self.level, 300)
        return 1 - survival(density, gauss([*-edges, *edges, *fine]), 0.0, self.steps)[-1]


class BoundedGusts(Case):
    """Bounded gusts must blow the same way for long to push a car off its lane."""

    steps = 60
    level = 0.62
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

    steps = 40
    noise_size = 12
    level = 5.0
    formula = f"always (x < {level})"

    def step(self, state: State, noise: Floats) -> State:
        energy = ((noise**2).sum(axis=1) - 12.0) / math.sqrt(24.0)
        return {"x": 0.8 * state["x"] + 0.5 * energy}

    def exact(self) -> float:
        unit = 0.5 / math.sqrt(24.0)

        def density(x: Floats, before: Floats, _: int) -> Floats:
            return chi2.pdf(12.0 + (x - 0.8 * before) / unit, 12) / unit

        return 1 - survival(density, panels(-5.0, self.level, 0.2), 0.0, self.steps)[-1]


class ClippedRisk(Case):
    """A risk is reported as a share between 0 and 1, clipped at both ends."""

    steps = 50
    level = 4.6
    formula = "always (risk < 1)"

    def step(self, state: State, noise: Floats) -> State:
        return {"x": 0.9 * state["x"] + math.sqrt(0.19) * noise[:, 0]}

    def signals(self, state: State) -> State:
        return {"risk": np.clip((state["x"] - 2.6) / (self.level - 2.6), 0.0, 1.0)}

    def exact(self) -> float:
        def density(x: Floats, before: Floats, _: int) -> Floats:
            return bell(x, 0.9 * before, math.sqrt(0.19))

        return 1 - survival(density, panels(-7.0, self.level, 0.5), 0.0, self.steps)[-1]


class DeceptiveOvertake(Case):
    """The margin of an overtaking car grows with its speed until, too fast, it loses grip."""

    steps = 40
    slow, grip, lost = -10.0 / 3.0, 2.6, 2.6 + 1.78 / 4.0
    formula = "always (margin > 0)"

    def step(self, state: State, noise: Floats) -> State:
        return {"x": 0.8 * state["x"] + 0.43 * noise[:, 0]}

    def signals(self, state: State) -> State:
        x = state["x"]
        return {"margin": np.where(x < self.grip, 1.0 + 0.3 * x, 4.0 * (self.lost - x))}

    def exact(self) -> float:
        def density(x: Floats, before: Floats, _: int) -> Floats:
            return bell(x, 0.8 * before, 0.43)

        return 1 - survival(density, panels(self.slow, self.lost, 0.4), 0.0, self.steps)[-1]


class Turbulence(Case):
    """The strength of the wind wanders unseen, and strong wind must meet gusts to move the car."""

    steps = 60
    noise_size = 2
    level = 4.0
    formula = f"always (x < {level} and x > -{level})"

    def initial(self, noise: Floats) -> State:
        return {"x": np.zeros(len(noise)), "wind": noise[:, 1]}

    def step(self, state: State, noise: Floats) -> State:
        wind = 0.95 * state["wind"] + math.sqrt(1 - 0.95**2) * noise[:, 1]
        return {"x": 0.8 * state["x"] + 0.1 * (1 + np.exp(0.7 * wind)) * noise[:, 0], "wind": wind}

    def exact(self) -> float:
        wind, weights = panels(-6.0, 6.0, 0.7)  # a regime each: their step is 0.31
        switches = bell(wind, 0.95 * wind[:, None], math.sqrt(1 - 0.95**2)) * weights

        def density(x: Floats, before: Floats, regime: int) -> Floats:
            return bell(x, 0.8 * before, 0.1 * (1 + np.exp(0.7 * wind[regime])))

        grid = panels(-self.level, self.level, 0.3)
        return 1 - survival(density, grid, 0.0, self.steps, switches, bell(wind) * weights)[-1]


class NearMiss(Case):
    """Three neighbours keep their places beside a car unevenly, and any of them may touch it."""

    steps = 40
    noise_size = 6
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
        safe = [self.survive(*home) for home in self.places]
        return float(1 - np.prod(safe))

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

    steps = 50
    noise_size = 3
    start = {"drift": np.zeros(3), "worst": np.zeros(3)}
    level = 3.3
    formula = f"always (second < {level})"

    def step(self, state: State, noise: Floats) -> State:
        drift = 0.95 * state["drift"] + math.sqrt(1 - 0.95**2) * noise
        return {"drift": drift, "worst": np.maximum(state["worst"], drift)}

    def signals(self, state: State) -> State:
        return {"second": np.sort(state["worst"], axis=1)[:, 1]}

    def exact(self) -> float:
        scale = math.sqrt(1 - 0.95**2)

        def density(x: Floats, before: Floats, _: int) -> Floats:
            return bell(x, 0.95 * before, scale)

        off = 1 - survival(density, panels(-7.0, self.level, 0.35), 0.0, self.steps)[-1]
        return 3 * off**2 * (1 - off) + off**3
