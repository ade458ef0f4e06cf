"""Problems without time."""

from __future__ import annotations

import math

import numpy as np
from scipy.special import ndtr
from scipy.stats import binom, chi2, norm

from . import exact
from .case import Floats, State, Static, threshold
from .exact import bell, gauss, panels


class BrakingDistance(Static):
    """A car brakes late, from too high a speed and on a wet road, and reaches the pedestrian."""

    noise_size, level = 3, 54.0
    formula = f"distance < {level}"

    def initial(self, noise: Floats) -> State:
        speed, delay = 14.0 + 1.2 * noise[:, 0], np.exp(-0.2 + 0.3 * noise[:, 1])
        return {"distance": speed * delay + speed**2 / (2 * np.maximum(6.0 + 0.7 * noise[:, 2], 1.0))}

    def exact(self) -> float:
        x, w = panels(-7.0, 7.0, 0.25)
        speed, brake = 14.0 + 1.2 * x[:, None], np.maximum(6.0 + 0.7 * x, 1.0)
        left = np.maximum((self.level - speed**2 / (2 * brake)) / speed, 1e-9)
        return float((w * bell(x)) @ norm.sf((np.log(left) + 0.2) / 0.3) @ (w * bell(x)))


class ParkingDiamond(Static):
    """A parked car's corner leaves the bay where the errors along and across add up, in any of four ways."""

    noise_size, level = 8, 5.2
    formula = f"reach < {level}"

    def initial(self, noise: Floats) -> State:
        along, across = noise[:, :4].sum(axis=1) / 2, noise[:, 4:].sum(axis=1) / 2
        return {"reach": np.abs(along) + np.abs(across)}

    def exact(self) -> float:
        x, weights = panels(-9.0, 9.0, 0.1, -self.level, self.level)
        sides = np.minimum(2 * norm.sf(self.level - np.abs(x)), 1.0)
        return float((sides * bell(x) * weights).sum())


class ResidualNorm(Static):
    """A map match is rejected since 500 small residuals are all a little larger than usual."""

    noise_size, method, level = 500, "closed form", 1.14
    formula = f"residual < {level}"

    def initial(self, noise: Floats) -> State:
        return {"residual": np.sqrt((noise**2).mean(axis=1))}

    def exact(self) -> float:
        return float(chi2.sf(500 * self.level**2, 500))


class LatencySum(Static):
    """Three modules in a row have latencies with heavy tails, and together they miss the deadline."""

    noise_size, level = 3, 200.0
    formula = f"latency < {level}"

    def initial(self, noise: Floats) -> State:
        return {"latency": (ndtr(-noise) ** -0.5).sum(axis=1)}

    def exact(self) -> float:
        s = (np.arange(300 * exact.ORDER) + 0.5) / (10 * exact.ORDER)  # minus logarithms of uniform numbers
        share, latency = np.exp(-s), np.exp(s / 2)
        share /= share.sum()
        left = np.maximum(self.level - latency[:, None] - latency, 1.0)
        return float(share @ left**-2.0 @ share)


class AliasedPattern(Static):
    """A localiser locks onto the wrong fence post where five ordinary errors match the posts' pattern."""

    noise_size, hidden, method = 6, True, "closed form"
    centre, width, level = np.array([0.5, -0.8, 0.2, -0.3, 0.9]), 0.24, 4.5
    formula = f"error < {level} and wrong_lock < 0.5"

    def initial(self, noise: Floats) -> State:
        lock = np.all(np.abs(noise[:, :5] - self.centre) < self.width, axis=1)
        return {"error": noise[:, 5], "wrong_lock": lock * 1.0}

    def exact(self) -> float:
        lock = np.prod(ndtr(self.centre + self.width) - ndtr(self.centre - self.width))
        return float(lock + (1 - lock) * norm.sf(self.level))


class ArrivalOrder(Static):
    """Eight cars block each other at an intersection after exactly one of the orders in which they come."""

    noise_size, hidden, method = 8, True, "closed form"
    order = (3, 0, 6, 1, 7, 4, 2, 5)
    formula = "deadlock < 0.5"

    def initial(self, noise: Floats) -> State:
        return {"deadlock": np.all(np.diff(noise[:, self.order], axis=1) > 0, axis=1) * 1.0}

    def exact(self) -> float:
        return 1 / math.factorial(8)


class UltrasonicSum(Static):
    """Six bounded errors of ultrasonic sensors are nearly all at their upper end."""

    noise_size, method, level = 6, "closed form", 5.4
    formula = f"error < {level}"

    def initial(self, noise: Floats) -> State:
        return {"error": ndtr(noise).sum(axis=1)}

    def exact(self) -> float:
        return (6 - self.level) ** 6 / math.factorial(6)


class LostPoints(Static):
    """A pedestrian is missed when most of 20 lidar points are lost, in fog that they share."""

    noise_size = 21
    limit, lost, shared = 14, 0.08, 0.5
    formula = f"lost < {limit}"

    def initial(self, noise: Floats) -> State:
        mixed = self.shared * noise[:, :1] + math.sqrt(1 - self.shared**2) * noise[:, 1:]
        return {"lost": (mixed > threshold(self.lost)).sum(axis=1) * 1.0}

    def exact(self) -> float:
        alone = math.sqrt(1 - self.shared**2)
        fog, weights = panels(-9.0, 9.0, 0.1)
        lost = norm.sf((threshold(self.lost) - self.shared * fog) / alone)
        return float((binom.sf(self.limit - 1, 20, lost) * bell(fog) * weights).sum())


class CappedTtc(Static):
    """A time to collision is capped for cars in other lanes, so it shows nothing until a car cuts in."""

    noise_size, method, level = 3, "closed form", 2.0
    formula = f"ttc > {level}"

    def initial(self, noise: Floats) -> State:
        gap, closing = 25.0 + 4.0 * noise[:, 0], 4.0 + 1.5 * noise[:, 1]
        cuts_in = 2.5 + 0.8 * noise[:, 2] < 1.0
        return {"ttc": np.where(cuts_in & (closing > 0.1), gap / np.maximum(closing, 0.1), 6.0)}

    def exact(self) -> float:
        return float(
            norm.sf(1.5 / 0.8) * norm.sf((25.0 - 4.0 * self.level) / math.hypot(4.0, 1.5 * self.level))
        )


class GainProducts(Static):
    """Errors of gain and of command multiply at five wheels, and the sum of the products turns the car."""

    noise_size, level = 10, 14.0
    formula = f"yaw < {level}"

    def initial(self, noise: Floats) -> State:
        return {"yaw": (noise[:, :5] * noise[:, 5:]).sum(axis=1)}

    def exact(self) -> float:
        x, w = gauss(np.linspace(0.0, 60.0, 200))  # half the difference of two chi-square numbers
        return float((chi2.pdf(x, 5) * chi2.sf(2 * self.level + x, 5) * w).sum())
