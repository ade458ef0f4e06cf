"""Problems without steps: a function of d normal numbers decides."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np

from benchmarks.calibration.problems.normal import log_above
from benchmarks.calibration.problems.problem import Floats, Problem

_EXACT, _QUADRATURE = "closed form", "quadrature"
_Function = Callable[[Floats], Floats]


def static_problems() -> Iterator[Problem]:
    """Yield the static problems; their levels follow from their probabilities."""
    yield from _one_region()
    yield from _several_regions()
    yield from _no_direction()
    yield from _deceptive()


def _one_region() -> Iterator[Problem]:
    for d, b, p in (
        (2, 2.3263478740408408, 1e-2), (100, 3.7190164854556804, 1e-4), (100, 4.753424308822899, 1e-6),
        (100, 5.9978070150076865, 1e-9), (1000, 4.264890793922825, 1e-5),
    ):  # fmt: skip
        yield _static(f"linear_d{d}_{p:.0e}", "one direction", d, p, _linear(b))
    for c, p in ((30.0, 7.121750862815577e-06), (40.0, 3.925932226286188e-09)):
        yield _static(f"exponential_sum_{c:.0f}", "one region, not Gaussian", 10, p, _exponentials(c))
    yield _static("lognormal_product_d5", "one region, not Gaussian", 5, 1e-6, _lognormal(203.2608115180556))
    yield _static("parabola", "curved", 2, 0.0030163119013095555, _parabola, _QUADRATURE)
    yield _static("staircase", "ties, one direction", 20, 1e-4, _staircase(3.7190164854556804))


def _several_regions() -> Iterator[Problem]:
    for beta, p in ((2.0, 1.0351370073191286e-3), (2.5, 7.711988691629287e-5), (3.0, 3.6444493915976075e-6)):
        yield _static(f"conjunction_{beta:g}", "two regions", 2, p, _conjunction(beta))
    for k, p in ((6.0, 0.004457331490626491), (7.0, 0.0022227950661944398)):
        yield _static(f"four_branch_{k:.0f}", "four regions", 2, p, _four_branch(k), _QUADRATURE)
    for c, p in ((8.0, 4.419462379832966e-05), (12.0, 6.748641704000155e-07)):
        yield _static(f"hyperbola_{c:.0f}", "two regions, curved", 2, p, _hyperbola(c), _QUADRATURE)
    for d, b, p in ((10, 4.891637590173203, 1e-5), (100, 4.891628734545832, 1e-4)):
        yield _static(f"largest_of_{d}", f"{2 * d} regions", d, p, _largest(b))
    yield _static("unequal_d10", "two regions, unequal", 10, _either(2e-4, 2e-5), _unequal)
    yield _static("units", "two regions, unequal units", 2, _either(1e-4, 1e-4), _units)


def _no_direction() -> Iterator[Problem]:
    for d, r, p in (
        (2, 27.631021115928547, 1e-6), (20, 71.58930867809084, 1e-7), (100, 172.09894203613814, 1e-5),
        (1000, 1174.933496584159, 1e-4),
    ):  # fmt: skip
        yield _static(f"sphere_d{d}", "every direction", d, p, _sphere(r))
    yield _static("slab", "thin", 2, 4.3659582860625795e-05, _slab)
    for p, text in ((1e-2, "1e-02"), (1e-3, "1e-03")):
        yield _static(f"scrambled_{text}", "no structure", 20, p, _scrambled(p))
    for b, p in ((2.3263478740408408, 1e-2), (3.090232306167813, 1e-3)):
        yield _static(f"yes_or_no_{p:.0e}", "discontinuous, nothing to follow", 2, p, _boolean(b))


def _deceptive() -> Iterator[Problem]:
    yield _static("late", "deceptive", 2, _either(1.3e-5, 3.4e-4), _late)
    yield _static("flat", "deceptive, hidden mode", 2, _either(3e-5, 2e-4), _flat)
    yield _static("flat_d20", "deceptive, hidden mode", 20, _either(3e-5, 2e-4), _flat)
    yield _static("misleading", "deceptive", 2, _either(3e-5, 1e-4), _misleading)


def _static(name: str, traits: str, d: int, p: float, robustness: _Function, source: str = _EXACT) -> Problem:
    return Problem(name, tuple(traits.split(", ")), d, p, 0.0, source, robustness)


def _either(*probabilities: float) -> float:
    """Return the probability of any of several independent modes."""
    return -math.expm1(sum(math.log1p(-p) for p in probabilities))


def _linear(b: float) -> _Function:
    return lambda z: b - z.sum(axis=1) / math.sqrt(z.shape[1])


def _staircase(b: float) -> _Function:
    """Return five steps on the way to the level; what is between two of them looks alike."""
    return lambda z: 1.0 - np.floor(5.0 * z.sum(axis=1) / math.sqrt(z.shape[1]) / b) / 5.0


def _exponentials(c: float) -> _Function:
    return lambda z: c + log_above(z).sum(axis=1)


def _lognormal(c: float) -> _Function:
    return lambda z: c - np.exp(0.5 * z.sum(axis=1))


def _parabola(z: Floats) -> Floats:
    """Return the curved limit state of Der Kiureghian and Dakessian (1998), b = 5, kappa = 0.5, e = 0.1."""
    return 5.0 - z[:, 1] - 0.5 * (z[:, 0] - 0.1) ** 2


def _conjunction(beta: float) -> _Function:
    return lambda z: np.maximum(beta - np.abs(z[:, 0]), beta - z[:, 1])


def _four_branch(k: float) -> _Function:
    def robustness(z: Floats) -> Floats:
        total, gap = z[:, 0] + z[:, 1], z[:, 0] - z[:, 1]
        curved = 3.0 + 0.1 * gap**2 - np.abs(total) / math.sqrt(2.0)
        return np.minimum(curved, k / math.sqrt(2.0) - np.abs(gap))

    return robustness


def _hyperbola(c: float) -> _Function:
    return lambda z: c - z[:, 0] * z[:, 1]


def _largest(b: float) -> _Function:
    return lambda z: b - np.abs(z).max(axis=1)


def _unequal(z: Floats) -> Floats:
    return np.minimum(1.0 - z[:, 0] / 3.5400837992061445, 1.0 - z[:, 1] / 4.10747958465625)


def _units(z: Floats) -> Floats:
    """Return metres in one term and millimetres in the other."""
    return np.minimum(3.7190164854556804 - z[:, 0], 1000.0 * (3.7190164854556804 - z[:, 1]))


def _sphere(r: float) -> _Function:
    return lambda z: r - (z * z).sum(axis=1)


def _slab(z: Floats) -> Floats:
    return np.abs(z[:, 0] - 3.005) - 0.005


def _scrambled(p: float) -> _Function:
    return lambda z: np.mod(1e4 * z.sum(axis=1), 1.0) - p


def _boolean(b: float) -> _Function:
    return lambda z: np.where(z.sum(axis=1) / math.sqrt(z.shape[1]) >= b, -1.0, 1.0)


def _late(z: Floats) -> Floats:
    rising = np.exp(np.minimum(4.0 * (z[:, 1] - 3.39751845977858), 50.0))
    return 1.0 - np.maximum(z[:, 0] / 4.205939313613331, rising)


def _flat(z: Floats) -> Floats:
    hidden = np.where(z[:, 1] >= 3.5400837992061445, 1.1, 0.0)
    return 1.0 - np.maximum(z[:, 0] / 4.012810811118254, hidden)


def _misleading(z: Floats) -> Floats:
    """Return a second mode that looks safest half way to its level."""
    share = z[:, 1] / 3.7190164854556804
    rising = -0.4 + 1.4 * (share - 0.7) / 0.3
    signal = np.where(share < 0.7, 0.3 - 0.4 * np.abs(share), np.where(share < 1.0, rising - 1e-12, rising))
    return 1.0 - np.maximum(z[:, 0] / 4.012810811118254, np.where(share >= 1.0, 1.1, signal))
