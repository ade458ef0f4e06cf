"""CasADi backend: fatrop, and ipopt where fatrop fails, one particle after another; the reference."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import casadi as ca
import numpy as np

from avrare.driving import Scene
from avrare.protocols import Bools, Floats
from avrare_mpc.config import MpcConfig
from avrare_mpc.nlp import Nlp, build_problem, pack_parameters
from avrare_mpc.plan import (
    SearchResult,
    cheapest,
    from_variables,
    initial_guesses,
    lane_centres,
    to_variables,
)
from avrare_mpc.signal_guard import defer_signals

# fatrop misses its default tolerance, 1e-8, in one solve of a hundred; 1e-7 gives actions good to 1e-8
_OPTIONS: dict[str, dict[str, Any]] = {
    "fatrop": {
        "structure_detection": "auto",
        "fatrop": {"print_level": 0, "max_iter": 300, "tol": 1e-7},
    },
    "ipopt": {"ipopt": {"print_level": 0, "sb": "yes", "max_iter": 500}},
}
_QUIET = {"print_time": False, "show_eval_warnings": False, "error_on_fail": False}


class CasadiSearch:
    """Backend (a ``Search``) that calls fatrop, and ipopt where fatrop fails.

    Args:
        config: Options.
        scene: Road and sizes.

    Raises:
        UsageError: The road lacks a lane of the configuration.
    """

    def __init__(self, config: MpcConfig, scene: Scene) -> None:
        self._scene, self._horizon = scene, config.horizon
        self._everywhere = config.search == "everywhere"
        self._centres = lane_centres(config, scene)
        self._solver = NlpSolver(build_problem(config, scene), config.solver)

    def __call__(
        self, solved: Bools, start: Floats, old: tuple[Floats, Floats], others: tuple[Floats, Floats]
    ) -> SearchResult:
        """See ``Search``."""
        parameters = pack_parameters(self._scene, start, *others)
        warm = to_variables(*old)
        guesses = list(warm[:, None])
        searched_anew = np.flatnonzero(~solved | self._everywhere)
        initial = initial_guesses(start[searched_anew], self._centres, self._horizon, self._scene.dt)
        for row, fresh in zip(searched_anew.tolist(), to_variables(*initial), strict=True):
            guesses[row] = np.concatenate([guesses[row], fresh]) if solved[row] else fresh
        rows = [self._search_row(several, given) for several, given in zip(guesses, parameters, strict=True)]
        variables = np.array([row[0] for row in rows]).reshape(warm.shape)
        solves, retries, chosen = np.array([row[1:] for row in rows], dtype=np.int64).reshape(-1, 3).T
        states, inputs = from_variables(variables)
        return SearchResult(states, inputs, chosen >= 0, solves, retries, chosen)

    def _search_row(self, guesses: Floats, parameters: Floats) -> tuple[Floats, int, int, int]:
        solutions = [self._solver.solve(guess, parameters) for guess in guesses]
        chosen = int(cheapest(np.array([[solution.cost for solution in solutions]]))[0])
        plan = solutions[chosen].variables if chosen >= 0 else None
        retries = sum(solution.retried for solution in solutions)
        return np.zeros_like(guesses[0]) if plan is None else plan, len(guesses), retries, chosen


@dataclass(frozen=True)
class Solution:
    """Result of one solve.

    Attributes:
        variables: Stage by stage, as in ``Nlp``; None where no solver succeeded.
        cost: Cost with the lateral penalty; infinite where no solver succeeded.
        retried: True if the first solver failed.
    """

    variables: Floats | None
    cost: float
    retried: bool


class NlpSolver:
    """Solver of one programme for many parameters; it has no state between calls.

    Args:
        nlp: The programme.
        first: Solver that is tried first.
    """

    def __init__(self, nlp: Nlp, first: Literal["fatrop", "ipopt"]) -> None:
        self._nlp = nlp
        self._names = ("fatrop", "ipopt") if first == "fatrop" else ("ipopt",)
        self._solvers: dict[str, _BufferedSolver] = {}

    def solve(self, guess: Floats, parameters: Floats) -> Solution:
        """Return the local minimum near ``guess`` (8 H + 5,)."""
        if not np.isfinite(parameters).all():
            return Solution(None, np.inf, retried=False)
        for name in self._names:
            if name not in self._solvers:
                self._solvers[name] = _BufferedSolver(self._nlp, name)
            variables, cost = self._solvers[name](guess, parameters)
            if variables is not None:
                return Solution(variables, cost, retried=name != self._names[0])
        return Solution(None, np.inf, retried=len(self._names) > 1)


class _BufferedSolver:
    """CasADi solver called through fixed buffers, which is faster than its own argument handling."""

    def __init__(self, nlp: Nlp, name: str) -> None:
        problem = {"x": nlp.variables, "p": nlp.parameters, "f": nlp.cost, "g": nlp.constraints}
        options = {**_QUIET, **_OPTIONS[name]}
        if name == "fatrop":
            options["equality"] = [bool(b) for b in nlp.lower == nlp.upper]
        self._function = ca.nlpsol(f"mpc_{name}", name, problem, options)
        buffer: Any
        buffer, self._evaluate = self._function.buffer()
        self._buffer = buffer
        size = nlp.variables.numel()
        self._guess, self._found, self._cost = np.zeros(size), np.zeros(size), np.zeros(1)
        self._parameters = np.zeros(nlp.parameters.numel())
        inputs = {
            "x0": self._guess,
            "p": self._parameters,
            "lbx": np.full(size, -np.inf),
            "ubx": np.full(size, np.inf),
            "lbg": nlp.lower,
            "ubg": nlp.upper,
            "lam_x0": np.zeros(size),
            "lam_g0": np.zeros(len(nlp.lower)),
        }
        for key, array in inputs.items():
            self._buffer.set_arg(self._function.index_in(key), array.data)
        self._buffer.set_res(self._function.index_out("x"), self._found.data)
        self._buffer.set_res(self._function.index_out("f"), self._cost.data)
        self._inputs = inputs  # the buffers point into these arrays

    def __call__(self, guess: Floats, parameters: Floats) -> tuple[Floats | None, float]:
        self._guess[:] = guess
        self._parameters[:] = parameters
        with defer_signals():
            self._evaluate()
        good = (
            self._buffer.stats()["success"] and np.isfinite(self._found).all() and np.isfinite(self._cost[0])
        )
        return (self._found.copy(), float(self._cost[0])) if good else (None, np.inf)
