"""Sets of problems with known probabilities."""

from __future__ import annotations

import runpy
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from itertools import chain

from avrare import Problem
from avrare.testing.problems import reference_problem, reference_problems
from benchmarks.studies.levels import read_case
from benchmarks.studies.untuned_problems import untuned_names, untuned_problem

from . import extra
from .problems import CASES
from .truths import stored

_REFERENCE = [problem.id for problem in reference_problems()]
SETS: dict[str, Sequence[str]] = {
    "unseen": tuple(CASES),
    "untuned": untuned_names(),
    "reference": _REFERENCE,
    "lattice": [*(name for name in _REFERENCE if name.startswith("f")), "shortest_queue", "lost_points"],
    "gate": ("cubic_4.6", "many_modes", "d_rw_L3.8"),
    "extra": tuple(extra.CASES),
}
"""Names: forty problems like those of driving, 32 with a trap, those of ``avrare.testing``, ten on a lattice,
three for decisions at a threshold, and others."""


def find_names(sets: str, file: str = "") -> list[str]:
    """Return the names of the problems of some sets, separated by commas, or of a file where there is one."""
    if file:
        return list(_read_file(file))
    return list(chain.from_iterable(SETS.get(name, (name,)) for name in sets.split(",")))


def is_static(name: str, file: str = "") -> bool:
    """Return whether a problem has no steps, so that no path can be split."""
    if not file and name in untuned_names():
        return name.startswith("static")
    return (bool(file) or ":" not in name) and find_problem(name, file)[0].steps == 0


def find_problem(name: str, file: str = "") -> tuple[Problem, float]:
    """Return a problem and its probability; SCENARIO:SPECIFICATION is one of ``studies.levels.read_case``."""
    if file:
        return _read_file(file)[name]()
    if ":" in name:
        return read_case(name)
    if name in CASES:
        return CASES[name].problem(), stored()[name]
    if name in untuned_names():
        untuned = untuned_problem(name)
        return untuned.problem(), untuned.probability
    if name in _REFERENCE:
        reference = reference_problem(name)
        return reference.problem(), reference.probability
    return extra.CASES[name]()


@cache
def _read_file(file: str) -> Mapping[str, Callable[[], tuple[Problem, float]]]:
    cases: Mapping[str, Callable[[], tuple[Problem, float]]] = runpy.run_path(file)["CASES"]
    return cases
