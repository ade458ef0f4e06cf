"""Pictures of one step of a slice: Fig. 2, 3 and 4 of stl-ess, on a Gaussian point with two corners.

    python benchmarks/slice_figures.py docs/slice-sampling

writes ellipse.png, surrogate.png and lipschitz.png: the exact cut of an ellipse, the Gaussian process of the
kernel ``bayesian``, and the arcs that a bound on the slope rules out. All three show the same ellipse.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from studies.figures import BLUE, GREEN, GREY, ORANGE, RED, make_axes

from avrare.protocols import Bools, Floats
from avrare_estimators.ess.kernels.elimination import free_angle
from avrare_estimators.ess.kernels.stl_ess import GRID, Acquisition, Posterior

_CIRCLE = 2.0 * math.pi
_CORNER = 1.0
"""The set: |x| and y are both at least this."""
_OWN, _OTHER = np.array([1.5, 1.25]), np.array([-2.0, 0.6])
_ANGLES = np.linspace(0.0, _CIRCLE, 2001)
_POINTS = 8


def score(point: Floats) -> Floats:
    """Return the robustness (...,) of reaching a corner, at points (..., 2)."""
    return np.asarray(np.minimum(np.abs(point[..., 0]), point[..., 1]) - _CORNER)


def on_ellipse(angle: Floats) -> Floats:
    """Return the points (..., 2) of the ellipse through the chain's own tape and a fresh one."""
    angle = np.asarray(angle)[..., None]
    return np.asarray(np.cos(angle) * _OWN + np.sin(angle) * _OTHER)


def crossings(axis: int, value: float) -> Floats:
    """Return the angles at which a coordinate of the ellipse has a value (Eq. 14), in closed form."""
    size = math.hypot(_OWN[axis], _OTHER[axis])
    if abs(value) > size:
        return np.zeros(0)
    turn, half = math.atan2(_OTHER[axis], _OWN[axis]), math.acos(value / size)
    return np.mod(np.array([turn - half, turn + half]), _CIRCLE)


def candidates() -> tuple[Floats, Floats]:
    """Return the angles at which a predicate changes: those where the score is 0, and the others."""
    found = np.sort(np.concatenate([crossings(0, _CORNER), crossings(0, -_CORNER), crossings(1, _CORNER)]))
    roots = np.abs(score(on_ellipse(found))) < 1e-9
    return found[roots], found[~roots]


def ellipse(path: Path) -> None:
    """Draw Fig. 2: half planes, the ellipse, its intersections, and the arcs on which the chain may land."""
    figure, (ax,) = make_axes(6.4, 5.2)
    for x in (-3.6, _CORNER):
        ax.add_patch(Rectangle((x, _CORNER), 2.6, 2.0, color=BLUE, alpha=0.13, lw=0))
    for draw, value in ((ax.axvline, _CORNER), (ax.axvline, -_CORNER), (ax.axhline, _CORNER)):
        draw(value, color=GREY, lw=0.9, ls=(0, (5, 3)))
    points, inside = on_ellipse(_ANGLES), score(on_ellipse(_ANGLES)) >= 0.0
    ax.plot(*points.T, color=GREY, lw=1.3)
    _segments(ax, points, inside)
    roots, other = candidates()
    ax.plot(*on_ellipse(roots).T, "^", color="black", ms=7, label="changes the formula: an end of an arc")
    ax.plot(*on_ellipse(other).T, "^", mfc="white", mec="black", ms=7, label="changes a predicate only")
    ax.plot(*_OWN, "o", color=ORANGE, ms=8, label="the chain's own point, x0")
    ax.plot(*_OTHER, "o", mfc="white", mec=ORANGE, ms=8, label="a fresh one, x1")
    new = on_ellipse(np.array(_uniform(inside, 0.62)))
    ax.plot(*new, "X", color=BLUE, ms=10, label="the next point: uniform in angle on the arcs")
    ax.set(xlabel="first number of the tape", ylabel="second number", xlim=(-3.6, 3.6), ylim=(-2.2, 3.0))
    ax.legend(frameon=False, fontsize=8, ncols=2, loc="upper center", bbox_to_anchor=(0.5, 1.2))
    _save(figure, path)


def surrogate(path: Path) -> None:
    """Draw Fig. 3: what a few rollouts tell the Gaussian process of the score along the ellipse."""
    angle = np.array([[0.0, _CIRCLE]])
    for _ in range(_POINTS):
        found = Posterior.fit(angle, score(on_ellipse(angle)))
        angle = np.concatenate([angle, found.most_promising(Acquisition())[:, None]], axis=1)
    found = Posterior.fit(angle, score(on_ellipse(angle)))
    mean, spread = (found.middle + found.scale * found.mean[0]), found.scale * found.spread[0]
    figure, (ax,) = make_axes(7.2, 4.4)
    ax.plot(_ANGLES, score(on_ellipse(_ANGLES)), color="black", lw=1.2, label="score, unknown")
    ax.plot(GRID, mean, color=BLUE, lw=1.4, ls=(0, (5, 2)), label="Gaussian process, two deviations")
    ax.fill_between(GRID, mean - 2.0 * spread, mean + 2.0 * spread, color=BLUE, alpha=0.15, lw=0)
    ax.axhline(0.0, color=GREY, lw=1.0, ls="-.", label="level")
    ax.plot(angle[0], score(on_ellipse(angle[0])), "o", color=RED, ms=5, label=f"{_POINTS} rollouts, and x0")
    roots, _ = candidates()
    ax.plot(roots, np.zeros(len(roots)), "^", color="black", ms=8, label="exact ends")
    active = mean >= 0.0
    low = score(on_ellipse(_ANGLES)).min() - 0.25
    ax.plot(GRID[active], np.full(active.sum(), low), "s", color=GREEN, ms=3, label="active by the process")
    drawn = GRID[active][int(0.6 * active.sum())]
    ax.plot(drawn, low, "X", color=BLUE, ms=9, label="drawn")
    ax.set(xlabel="angle [rad]", ylabel="score")
    ax.legend(frameon=False, fontsize=8, ncols=2, loc="upper center", bbox_to_anchor=(0.5, 1.28))
    _save(figure, path)


def lipschitz(path: Path) -> None:
    """Draw Fig. 4: each rollout below the level rules out the angles that the slope keeps below it."""
    slope = math.hypot(*np.linalg.svd(np.stack([_OWN, _OTHER]), compute_uv=False)[:1])
    center, half, uniforms = np.zeros((1, 0)), np.zeros((1, 0)), iter((0.42, 0.80, 0.33, 0.61, 0.1, 0.9))
    figure, (ax,) = make_axes(7.2, 4.4)
    ax.plot(_ANGLES, score(on_ellipse(_ANGLES)), color=BLUE, lw=1.2, label="score, unknown")
    ax.axhline(0.0, color=GREY, lw=1.0, ls="-.", label="level")
    low = score(on_ellipse(_ANGLES)).min() - 0.3
    for turn, uniform in enumerate(uniforms, start=1):
        angle = float(free_angle(center, half, np.array([uniform]))[0][0])
        value = float(score(on_ellipse(np.array(angle))))
        ax.annotate(f"θ{turn}", (angle, value), (4, 6), textcoords="offset points", fontsize=9)
        if value >= 0.0:
            ax.plot(angle, value, "X", color=BLUE, ms=9, label="in the set: the next point")
            break
        ax.plot(angle, value, "o", color=RED, ms=5)
        reach = -value / slope
        ends = np.array([angle - reach, angle + reach])
        ax.plot([ends[0], angle, ends[1]], [0.0, value, 0.0], color=RED, lw=0.8, ls=":")
        ax.plot(ends, [low - 0.12 * turn] * 2, color=RED, lw=4, solid_capstyle="butt", alpha=0.7)
        center = np.concatenate([center, [[angle]]], axis=1)
        half = np.concatenate([half, [[reach]]], axis=1)
    ax.plot([], [], color=RED, lw=4, alpha=0.7, label="ruled out: ± (level - score) / slope")
    ax.set(xlabel="angle [rad]", ylabel="score", xlim=(-0.3, _CIRCLE + 0.3))
    ax.legend(frameon=False, fontsize=8, ncols=2, loc="upper center", bbox_to_anchor=(0.5, 1.2))
    _save(figure, path)


def _segments(ax: Axes, points: Floats, inside: Bools) -> None:
    shown = np.where(inside[:, None], points, np.nan)
    ax.plot(*shown.T, color=GREEN, lw=3.5, label="arcs in the set")


def _uniform(inside: Bools, share: float) -> float:
    angles = _ANGLES[inside]
    return float(angles[int(share * (len(angles) - 1))])


def _save(figure: Figure, path: Path) -> None:
    figure.savefig(path, dpi=110)
    print(path)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    for draw in (ellipse, surrogate, lipschitz):
        draw(folder / f"{draw.__name__}.png")


if __name__ == "__main__":
    main()
