"""One compiled solver for many parameter vectors: fatrop, and ipopt where fatrop fails."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from avrare_mpc.nlp import Nlp
from avrare_mpc.uninterrupted import uninterrupted

Floats = NDArray[np.float64]

# fatrop's own tolerance, 1e-8, is out of reach in one solve of a hundred; 1e-7 leaves actions good to 1e-8.
_OPTIONS: dict[str, dict[str, Any]] = {
    "fatrop": {
        "structure_detection": "auto",
        "fatrop": {"print_level": 0, "max_iter": 300, "tol": 1e-7},
    },
    "ipopt": {"ipopt": {"print_level": 0, "sb": "yes", "max_iter": 500}},
}
_QUIET = {"print_time": False, "show_eval_warnings": False, "error_on_fail": False}


@dataclass(frozen=True)
class Solution:
    """What came of one solve.

    Attributes:
        variables: Stage by stage, as in ``Nlp``; None when no solver succeeded.
        cost: Cost with the lateral penalty; infinite when no solver succeeded.
        retried: The first solver failed.
    """

    variables: Floats | None
    cost: float
    retried: bool


class NlpSolver:
    """Solves one programme for many parameters. It keeps nothing from one call to the next.

    Args:
        nlp: The programme.
        first: The solver that is tried first.
    """

    def __init__(self, nlp: Nlp, first: Literal["fatrop", "ipopt"]) -> None:
        self._nlp = nlp
        self._names = ("fatrop", "ipopt") if first == "fatrop" else ("ipopt",)
        self._solvers: dict[str, _Compiled] = {}

    def solve(self, guess: Floats, parameters: Floats) -> Solution:
        """The local minimum that the solvers find from ``guess`` (8 H + 5,); see ``Solution``."""
        if not np.isfinite(parameters).all():
            return Solution(None, np.inf, retried=False)
        for name in self._names:
            if name not in self._solvers:
                self._solvers[name] = _Compiled(self._nlp, name)
            variables, cost = self._solvers[name](guess, parameters)
            if variables is not None:
                return Solution(variables, cost, retried=name != self._names[0])
        return Solution(None, np.inf, retried=len(self._names) > 1)


class _Compiled:
    """A CasADi solver called through fixed buffers, which costs less than its own argument handling."""

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
        with uninterrupted():
            self._evaluate()
        good = (
            self._buffer.stats()["success"] and np.isfinite(self._found).all() and np.isfinite(self._cost[0])
        )
        return (self._found.copy(), float(self._cost[0])) if good else (None, np.inf)
