"""Riccati backend: plans of all particles by the interior-point method."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np

from avrare.driving import Scene
from avrare.protocols import Bools, Floats
from avrare_mpc.config import MpcConfig
from avrare_mpc.plan import Integers, SearchResult, cheapest, initial_inputs, lane_centres, lateral_bounds
from avrare_mpc.riccati.batch import Answer, Jobs, solve_all
from avrare_mpc.riccati.jit import COMPILED, announce
from avrare_mpc.riccati.newton import FOUND
from avrare_mpc.riccati.values import Bounds, Programme, Tuning, memory, new_memory

Problems = tuple[Floats, ...]
"""Current states, predicted x and predicted y of N programmes."""
QUICK = Tuning(start=3e-2, end=1e-9, reduce=0.1, step=1e-6, iterations=200)
PATIENT = Tuning(start=1.0, end=1e-9, reduce=0.3, step=1e-6, iterations=800)
NEAR = Tuning(start=1e-4, end=1e-4, reduce=0.1, step=1e-2, iterations=60)
"""Second, rough search: its small barrier stays nearer to the guess, where a better minimum may be."""
FROM_NEAR = Tuning(start=1e-4, end=1e-9, reduce=0.1, step=1e-6, iterations=200)
BETTER = 1e-3
"""Relative gain from which a rough search is completed."""


@dataclass(frozen=True)
class Solutions:
    """Results of M searches.

    Attributes:
        states: (M, H + 1, 4) x, y, speed, heading.
        inputs: (M, H, 2) acceleration, turn rate.
        cost: (M,) with the lateral penalty.
        feasible: (M,) whether it is a minimum within every hard bound; elsewhere the search ended there.
        retried: (M,) whether the first attempt failed, whatever the result of the second one.
        iterations: (M,) iterations of all attempts and searches.
    """

    states: Floats
    inputs: Floats
    cost: Floats
    feasible: Bools
    retried: Bools
    iterations: Integers


class RiccatiSolver:
    """Solver of the controller's programme for many particles; it has no state between calls.

    Args:
        config: Options.
        scene: Road and sizes.
        quick: First attempt.
        patient: Second attempt, where the first one fails.
        near: Rough search for another minimum; None for none.

    Raises:
        UsageError: The road lacks a lane of the configuration.
    """

    def __init__(
        self,
        config: MpcConfig,
        scene: Scene,
        quick: Tuning = QUICK,
        patient: Tuning = PATIENT,
        near: Tuning | None = NEAR,
    ) -> None:
        self.programme = programme(config, scene)
        self._addressed = take_addresses(self.programme)
        self._tunings, self._near = (quick, patient), near
        hard = 2 if config.lateral_acceleration_max is None else 3
        self._bounds = Bounds(hard, soft=1), Bounds(hard, soft=3)
        if not COMPILED:
            warnings.warn(
                "numba is not installed: the riccati backend of the controller mpc is not compiled and takes "
                "hundreds of times longer (pip install 'avrare-mpc[fast]')",
                stacklevel=2,
            )
            return
        with announce("note: the controller mpc is compiled, once for this machine and version (some 15 s)"):
            nobody = (len(scene.lengths), config.horizon + 1)
            problems = np.zeros((0, 5)), np.zeros((0, *nobody)), np.zeros((0, *nobody))
            self._run(self._bounds[0], quick, problems, np.zeros(0, int), np.zeros((0, config.horizon, 2)))

    def solve(
        self, start: Floats, other_x: Floats, other_y: Floats, rows: Integers, guesses: Floats
    ) -> Solutions:
        """Return local minima of programmes ``rows[m]`` near ``guesses[m]``; of two minima the cheaper one.

        Args:
            start: (N, 5) x, y, speed, heading now, and the last turn rate; all arguments are finite.
            other_x: (N, V, H + 1) predicted positions [m].
            other_y: (N, V, H + 1) predicted positions [m].
            rows: (M,) indices of the programmes.
            guesses: (M, H, 2) inputs.
        """
        problems, rows, guesses = _contiguous(start, other_x, other_y, rows, guesses)
        solutions = self._minima(problems, rows, guesses, self._tunings)
        if self._near is not None and len(rows):
            self._improve(solutions, np.arange(len(rows)), self._near, problems, rows, guesses)
        return solutions

    def improve(
        self,
        solutions: Solutions,
        index: Integers,
        start: Floats,
        other_x: Floats,
        other_y: Floats,
        rows: Integers,
        guesses: Floats,
    ) -> None:
        """Search from other guesses, roughly first, and replace ``solutions[index]`` by cheaper plans.

        Args:
            solutions: Result of ``solve``, changed in place.
            index: (G,) entries to improve; only the best of an entry's rough plans is completed.
            start: (N, 5) states as in ``solve``.
            other_x: (N, V, H + 1) predicted positions [m].
            other_y: (N, V, H + 1) predicted positions [m].
            rows: (G,) indices of the programmes.
            guesses: (G, C, H, 2) inputs, far from the minimum.
        """
        if not len(index):
            return
        candidates = np.repeat(rows, guesses.shape[1]), guesses.reshape(-1, *guesses.shape[2:])
        # rough search from an initial guess, far from the minimum
        from_initial = Tuning(start=3e-2, end=1e-4, reduce=0.1, step=1e-2, iterations=60)
        self._improve(solutions, index, from_initial, *_contiguous(start, other_x, other_y, *candidates))

    def _improve(
        self,
        solutions: Solutions,
        index: Integers,
        rough: Tuning,
        problems: Problems,
        rows: Integers,
        guesses: Floats,
    ) -> None:
        first = self._run(self._bounds[0], rough, problems, rows, guesses)
        several = len(index), -1
        solutions.iterations[index] += first.iterations.reshape(several).sum(axis=1)
        cost = np.where(np.isfinite(first.inputs).all(axis=(1, 2)), first.cost, np.inf).reshape(several)
        cost[np.isnan(cost)] = np.inf
        best = cost.argmin(axis=1)
        least = cost.min(axis=1)
        promising = (~solutions.feasible[index] & (least < np.inf)) | (
            least < (1.0 - BETTER) * solutions.cost[index]
        )
        finish = np.flatnonzero(promising)
        if len(finish):
            best = best[finish] + cost.shape[1] * finish
            other = self._minima(problems, rows[best], first.inputs[best], (FROM_NEAR, self._tunings[1]))
            _take_better(solutions, index[finish], other)

    def _minima(
        self, problems: Problems, rows: Integers, guesses: Floats, tunings: tuple[Tuning, Tuning]
    ) -> Solutions:
        """Find a local minimum from each guess.

        The bounds of speed and heading are rarely active: they are omitted until a plan violates them.
        """
        answer = _blank(*guesses.shape[:2])
        feasible, retried = np.zeros(len(rows), dtype=np.bool_), np.zeros(len(rows), dtype=np.bool_)
        todo = np.arange(len(rows))
        tolerance = 1e-6  # allowed violation of the bounds of speed and heading [m/s, rad]
        for bounds, allowed in zip(self._bounds, (np.inf, tolerance), strict=True):
            for number, tuning in enumerate(tunings):
                if not len(todo):
                    break
                part = self._run(bounds, tuning, problems, rows[todo], guesses[todo])
                _store(answer, todo, part)
                retried[todo] |= number == 1
                feasible[todo] = (part.status == FOUND) & np.isfinite(part.cost) & (part.excess <= allowed)
                todo = todo[~feasible[todo]]
            todo = np.flatnonzero(feasible & (answer.excess > tolerance))
        return Solutions(answer.states, answer.inputs, answer.cost, feasible, retried, answer.iterations)

    def _run(
        self, bounds: Bounds, tuning: Tuning, problems: Problems, rows: Integers, guesses: Floats
    ) -> Answer:
        part = _blank(*guesses.shape[:2])
        inputs = (*problems, rows.astype(np.float64), guesses)
        p = self._addressed
        _, path, trial, work = workspace = new_memory(p.steps, p.vehicles)
        jobs, answer = Jobs(*map(memory, inputs)), Answer(*map(memory, part))
        with np.errstate(all="ignore"):  # in plain Python a search that overflows would warn
            solve_all(p, bounds, tuning, jobs, len(rows), answer, path, trial, work)
        del workspace
        return part


def take_addresses(p: Programme) -> Programme:
    """Return the programme with raw addresses for the compiled kernels; keep the original alive meanwhile."""
    arrays = ("centres", "reach_x", "reach_y", "low", "high", "penalty")
    return p._replace(**{name: memory(getattr(p, name)) for name in arrays})


def _contiguous(
    start: Floats, other_x: Floats, other_y: Floats, rows: Integers, guesses: Floats
) -> tuple[Problems, Integers, Floats]:
    # kernels read memory as it lies there
    problems = tuple(np.require(part, np.float64, ("C", "A")) for part in (start, other_x, other_y))
    return problems, np.require(rows, np.int64, ("C", "A")), np.require(guesses, np.float64, ("C", "A"))


def _take_better(solutions: Solutions, index: Integers, other: Solutions) -> None:
    solutions.iterations[index] += other.iterations
    better = other.feasible & (~solutions.feasible[index] | (other.cost < solutions.cost[index]))
    for name in ("states", "inputs", "cost", "feasible"):
        getattr(solutions, name)[index[better]] = getattr(other, name)[better]


def _blank(searches: int, steps: int) -> Answer:
    return Answer(
        states=np.empty((searches, steps + 1, 4)),
        inputs=np.empty((searches, steps, 2)),
        cost=np.empty(searches),
        excess=np.empty(searches),
        status=np.empty(searches),
        iterations=np.zeros(searches),
    )


def _store(answer: Answer, index: Integers, part: Answer) -> None:
    part.iterations[:] += answer.iterations[index]
    for target, values in zip(answer, part, strict=True):
        target[index] = values


def programme(config: MpcConfig, scene: Scene) -> Programme:
    """Collect weights, goals and bounds of a scene's controller."""
    dt, low_high = scene.dt, lateral_bounds(config, scene)
    change, rate = config.turn_rate_change_weight, config.turn_rate_weight
    lateral = config.lateral_acceleration_max
    by_speed = config.lateral_lead == "speed"
    along = config.clearance_ego_lengths * scene.ego_length + config.clearance_x
    across = config.clearance_ego_widths * scene.ego_width + config.clearance_y
    # penalty of speed and heading beyond their bounds; a plan that pays it is rejected [s/m, 1/rad]
    hard_penalty = 1e7
    return Programme(
        steps=config.horizon,
        vehicles=len(scene.lengths),
        road_lanes=len(config.lanes),
        dt=dt,
        centres=np.array(lane_centres(config, scene)),
        reach_x=along + np.asarray(scene.lengths, dtype=np.float64) / 2,
        reach_y=across + np.asarray(scene.widths, dtype=np.float64) / 2,
        lead_speed=dt + dt**2 if by_speed else dt,
        lead_acceleration=0.0 if by_speed else dt**2,
        start_change_weight=change if config.smooth_start else 0.0,
        final_turn_rate=change * rate / (change + rate) if change + rate else 0.0,
        lateral_max=np.inf if lateral is None else lateral,
        low=np.array([low_high[0], config.speed_min, -config.heading_max]),
        high=np.array([low_high[1], config.speed_max, config.heading_max]),
        penalty=np.array([config.y_penalty, hard_penalty, hard_penalty]),
        **{
            name: getattr(config, name)
            for name in Programme._fields
            if name in MpcConfig.model_fields and name != "lanes"
        },
    )


class RiccatiSearch:
    """Backend (a ``Search``) that calls ``RiccatiSolver``; see there for the arguments."""

    def __init__(self, config: MpcConfig, scene: Scene) -> None:
        self._centres = lane_centres(config, scene)
        self._steps, self._dt = config.horizon, scene.dt
        self._solver = RiccatiSolver(config, scene)
        self._everywhere = config.search == "everywhere"

    def __call__(
        self, solved: Bools, start: Floats, old: tuple[Floats, Floats], others: tuple[Floats, Floats]
    ) -> SearchResult:
        """See ``Search``."""
        n = len(solved)
        fresh, initial = np.flatnonzero(~solved), self._initial_guesses(start[~solved])
        # one entry per solve: row of the particle, number of the guess, its inputs
        rows = np.concatenate([np.flatnonzero(solved), np.repeat(fresh, initial.shape[1])])
        numbers = np.concatenate(
            [np.zeros(solved.sum(), int), np.tile(np.arange(initial.shape[1]), len(fresh))]
        )
        guesses = np.concatenate([old[1][solved], initial.reshape(-1, self._steps, 2)])
        valid = _valid(start, *others)[rows] & np.isfinite(guesses).all(axis=(1, 2))
        solution = self._solver.solve(start, *others, rows[valid], guesses[valid])
        searched = self._search_everywhere(solution, start, others, rows[valid], solved)
        cost = np.full((n, initial.shape[1]), np.inf)
        place = np.full(cost.shape, -1)
        cost[rows[valid], numbers[valid]] = np.where(solution.feasible, solution.cost, np.inf)
        place[rows[valid], numbers[valid]] = np.arange(valid.sum())
        chosen = cheapest(cost)
        feasible = chosen >= 0
        states, inputs = np.zeros((n, self._steps + 1, 4)), np.zeros((n, self._steps, 2))
        best = place[feasible, chosen[feasible]]
        states[feasible], inputs[feasible] = solution.states[best], solution.inputs[best]
        retries = np.bincount(rows[valid][solution.retried], minlength=n)
        solves = np.bincount(rows, minlength=n) + np.bincount(searched, minlength=n)
        return SearchResult(states, inputs, feasible, solves, retries, chosen)

    def _search_everywhere(
        self, solution: Solutions, start: Floats, others: tuple[Floats, Floats], rows: Integers, solved: Bools
    ) -> Integers:
        index = np.flatnonzero(solved[rows] & self._everywhere)
        initial = self._initial_guesses(start[rows[index]])
        self._solver.improve(solution, index, start, *others, rows[index], initial)
        return np.repeat(rows[index], initial.shape[1])

    def _initial_guesses(self, start: Floats) -> Floats:
        with np.errstate(invalid="ignore"):
            return initial_inputs(start, self._centres, self._steps, self._dt)


def _valid(start: Floats, other_x: Floats, other_y: Floats) -> Bools:
    # rows with larger positions or speeds are not solved: their squares would dominate every other cost
    most_magnitude = 1e9
    others = (np.abs(other_x) <= most_magnitude) & (np.abs(other_y) <= most_magnitude)
    return np.asarray((np.abs(start) <= most_magnitude).all(axis=1) & others.all(axis=(1, 2)))
