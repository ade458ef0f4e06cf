"""Arrays in, plans out: the interior-point method for N particles."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from avrare.driving import Scene
from avrare_mpc.config import MpcConfig
from avrare_mpc.lanes import lane_centres, lateral_bounds
from avrare_mpc.riccati.batch import Answer, Integers, solve_with_bounds, solve_without_bounds
from avrare_mpc.riccati.jit import COMPILED
from avrare_mpc.riccati.newton import FOUND
from avrare_mpc.riccati.values import Floats, Programme, Tuning

Given = tuple[Floats, ...]
"""States now, predicted x and predicted y of the programmes."""
QUICK = Tuning(start=3e-2, end=1e-9, reduce=0.1, step=1e-6, iterations=200)
PATIENT = Tuning(start=1.0, end=1e-9, reduce=0.3, step=1e-6, iterations=800)
NEAR = Tuning(start=1e-4, end=1e-4, reduce=0.1, step=1e-2, iterations=60)
"""A second, rough search with a small barrier stays nearer to the guess: at times that minimum is better."""
DRIVE = Tuning(start=3e-2, end=1e-4, reduce=0.1, step=1e-2, iterations=60)
"""A rough search from a start drive, far from the minimum."""
FROM_NEAR = Tuning(start=1e-4, end=1e-9, reduce=0.1, step=1e-6, iterations=200)
BETTER = 1e-3
"""Relative gain from which the second minimum is worth finishing."""
TOLERANCE = 1e-6
"""How far speed or heading may be outside their bounds [m/s, rad]."""
HARD = 1e7
"""Penalty of speed and heading outside their bounds; a plan that pays it is refused [s/m, 1/rad]."""


@dataclass(frozen=True)
class Solutions:
    """What came of M searches.

    Attributes:
        states: (M, H + 1, 4) x, y, speed, heading.
        inputs: (M, H, 2) acceleration, turn rate.
        cost: (M,) with the lateral penalty.
        found: (M,) this is a minimum that keeps every hard bound; elsewhere it is where the search ended.
        retried: (M,) the first attempt failed, whatever came of the second search.
        iterations: (M,) of all attempts and searches.
    """

    states: Floats
    inputs: Floats
    cost: Floats
    found: NDArray[np.bool_]
    retried: NDArray[np.bool_]
    iterations: Integers


class RiccatiSolver:
    """Solves the controller's programme for many particles. It keeps nothing from one call to the next.

    Args:
        config: Options.
        scene: Road and sizes.
        quick: First attempt.
        patient: Second attempt, where the first one fails.
        near: Rough search for another minimum, None: none.

    Raises:
        UsageError: The road lacks a lane of the configuration.
    """

    def __init__(
        self, config: MpcConfig, scene: Scene, quick: Tuning = QUICK, patient: Tuning = PATIENT,
        near: Tuning | None = NEAR,
    ) -> None:  # fmt: skip
        self.programme = programme(config, scene)
        self._tunings, self._near = (quick, patient), near
        if not COMPILED:
            warnings.warn(
                "numba is not installed: the riccati backend of the controller mpc is not compiled and takes "
                "hundreds of times longer (pip install 'avrare-mpc[fast]')",
                stacklevel=2,
            )

    def solve(
        self, start: Floats, other_x: Floats, other_y: Floats, rows: Integers, guesses: Floats
    ) -> Solutions:
        """Local minima of programme ``rows[m]`` near ``guesses[m]``, all finite; of two the cheaper one.

        Args:
            start: (N, 4) x, y, speed, heading now.
            other_x: (N, V, H + 1) predicted positions [m].
            other_y: (N, V, H + 1) predicted positions [m].
            rows: (M,) of the programmes.
            guesses: (M, H, 2) inputs.
        """
        given, rows, guesses = _laid_out(start, other_x, other_y, rows, guesses)
        found = self._minima(given, rows, guesses, self._tunings)
        if self._near is not None:
            self._improve(found, np.arange(len(rows)), self._near, given, rows, guesses)
        return found

    def improve(
        self, found: Solutions, index: Integers, start: Floats, other_x: Floats, other_y: Floats,
        rows: Integers, guesses: Floats,
    ) -> None:  # fmt: skip
        """Search ``found[index]`` from other guesses too, roughly first; cheaper plans take their place.

        Args:
            found: What ``solve`` gave, changed in place.
            index: (G,) its entries to improve.
            start: As for ``solve``.
            other_x: As for ``solve``.
            other_y: As for ``solve``.
            rows: (G,) of the programmes.
            guesses: (G, H, 2) inputs, far from the minimum.
        """
        self._improve(found, index, DRIVE, *_laid_out(start, other_x, other_y, rows, guesses))

    def _improve(
        self, found: Solutions, index: Integers, rough: Tuning, given: Given, rows: Integers, guesses: Floats
    ) -> None:
        first = _run(solve_without_bounds, self.programme, rough, given, rows, guesses)
        found.iterations[index] += first.iterations
        with np.errstate(invalid="ignore"):
            promising = ~found.found[index] | (first.cost < (1.0 - BETTER) * found.cost[index])
        again = np.flatnonzero(promising & np.isfinite(first.inputs).all(axis=(1, 2)))
        if len(again):
            other = self._minima(given, rows[again], first.inputs[again], (FROM_NEAR, self._tunings[1]))
            _take_better(found, index[again], other)

    def _minima(
        self, given: Given, rows: Integers, guesses: Floats, tunings: tuple[Tuning, Tuning]
    ) -> Solutions:
        """One local minimum each.

        The bounds of speed and heading hardly ever matter: they are left out until a plan breaks them.
        """
        answer = _blank(*guesses.shape[:2])
        found, retried = np.zeros(len(rows), dtype=np.bool_), np.zeros(len(rows), dtype=np.bool_)
        todo = np.arange(len(rows))
        for kernel, allowed in ((solve_without_bounds, np.inf), (solve_with_bounds, TOLERANCE)):
            for number, tuning in enumerate(tunings):
                if not len(todo):  # a kernel that is not needed is not compiled either
                    break
                part = _run(kernel, self.programme, tuning, given, rows[todo], guesses[todo])
                _place(answer, todo, part)
                retried[todo] |= number == 1
                found[todo] = (part.status == FOUND) & np.isfinite(part.cost) & (part.excess <= allowed)
                todo = todo[~found[todo]]
            todo = np.flatnonzero(found & (answer.excess > TOLERANCE))
        return Solutions(answer.states, answer.inputs, answer.cost, found, retried, answer.iterations)


def _laid_out(
    start: Floats, other_x: Floats, other_y: Floats, rows: Integers, guesses: Floats
) -> tuple[Given, Integers, Floats]:
    """One memory layout, or the kernels would be compiled once more for every other one."""
    given = tuple(np.require(part, np.float64, ("C", "W")) for part in (start, other_x, other_y))
    return given, np.require(rows, np.int64, ("C", "W")), np.require(guesses, np.float64, ("C", "W"))


def _run(
    kernel: Callable[..., object], programme: Programme, tuning: Tuning, given: Given, rows: Integers,
    guesses: Floats,
) -> Answer:  # fmt: skip
    part = _blank(*guesses.shape[:2])
    with np.errstate(all="ignore"):  # not compiled, a search that overflows would warn
        kernel(programme, tuning, *given, rows, guesses, part)
    return part


def _take_better(found: Solutions, index: Integers, other: Solutions) -> None:
    """Put ``other`` in the place of entries ``index`` where it is cheaper, or the only one."""
    found.iterations[index] += other.iterations
    better = other.found & (~found.found[index] | (other.cost < found.cost[index]))
    for name in ("states", "inputs", "cost", "found"):
        getattr(found, name)[index[better]] = getattr(other, name)[better]


def _blank(searches: int, steps: int) -> Answer:
    return Answer(
        states=np.empty((searches, steps + 1, 4)),
        inputs=np.empty((searches, steps, 2)),
        cost=np.empty(searches),
        excess=np.empty(searches),
        status=np.empty(searches, dtype=np.int64),
        iterations=np.zeros(searches, dtype=np.int64),
    )


def _place(answer: Answer, index: Integers, part: Answer) -> None:
    part.iterations[:] += answer.iterations[index]
    for whole, some in zip(answer, part, strict=True):
        whole[index] = some


def programme(config: MpcConfig, scene: Scene) -> Programme:
    """Weights, goals and bounds of a scene's controller."""
    dt, low_high = scene.dt, lateral_bounds(config, scene)
    change, rate = config.turn_rate_change_weight, config.turn_rate_weight
    by_speed = config.lateral_lead == "speed"
    along = config.clearance_ego_lengths * scene.ego_length + config.clearance_x
    across = config.clearance_ego_widths * scene.ego_width + config.clearance_y
    return Programme(
        dt=dt,
        centres=np.array(lane_centres(config, scene)),
        reach_x=along + np.asarray(scene.lengths, dtype=np.float64) / 2,
        reach_y=across + np.asarray(scene.widths, dtype=np.float64) / 2,
        lead_speed=dt + dt**2 if by_speed else dt,
        lead_acceleration=0.0 if by_speed else dt**2,
        y_goal=config.y_goal,
        y_goal_weight=config.y_goal_weight,
        v_goal=config.v_goal,
        v_goal_weight=config.v_goal_weight,
        heading_weight=config.heading_weight,
        acceleration_weight=config.acceleration_weight,
        braking_weight=config.braking_weight,
        turn_rate_weight=rate,
        turn_rate_change_weight=change,
        final_turn_rate=change * rate / (change + rate) if change + rate else 0.0,
        lane_weight=config.lane_weight,
        obstacle_weight=config.obstacle_weight,
        sharpness=config.sharpness,
        acceleration_max=config.acceleration_max,
        turn_rate_max=config.turn_rate_max,
        low=np.array([low_high[0], config.speed_min, -config.heading_max]),
        high=np.array([low_high[1], config.speed_max, config.heading_max]),
        penalty=np.array([config.y_penalty, HARD, HARD]),
    )
