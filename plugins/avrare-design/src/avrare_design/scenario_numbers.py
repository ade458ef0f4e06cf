"""Numbers of a scenario that change together: single ones, lists, matrices, and arrays of a network."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from avrare.base.errors import UsageError
from avrare.protocols import Bools, Floats
from avrare.rollout.loaded_scenario import LoadedScenario
from avrare_design.scenario_parameters import ParametricScenario, look_up


@dataclass(frozen=True)
class ScenarioNumbers:
    """P numbers of a scenario. Zeros of a list or matrix that has other numbers are its structure, and stay.

    Attributes:
        scenario: The scenario.
        paths: Dotted paths, each of a number, a list or a matrix.
        arrays: Their values in the scenario.
    """

    scenario: ParametricScenario
    paths: tuple[str, ...]
    arrays: tuple[Floats, ...]

    @staticmethod
    def of(scenario: ParametricScenario, paths: Sequence[str]) -> ScenarioNumbers:
        """Find the numbers; UsageError where a path has none."""
        distinct = tuple(dict.fromkeys(paths))
        return ScenarioNumbers(scenario, distinct, tuple(_find(scenario, path) for path in distinct))

    @property
    def names(self) -> tuple[str, ...]:
        """Dotted path of each number (P,)."""
        pairs = zip(self.paths, self.arrays, strict=True)
        return tuple(
            ".".join((path, *map(str, index)))
            for path, array in pairs
            for index in np.argwhere(_moves(array))
        )

    @property
    def start(self) -> Floats:
        """(P,) values in the scenario."""
        return np.concatenate([array[_moves(array)] for array in self.arrays])

    @property
    def scale(self) -> Floats:
        """(P,) the unit in which each number moves: its size, or 1 where it is 0."""
        return np.where(self.start == 0.0, 1.0, np.abs(self.start))

    def settings(self, values: Floats) -> tuple[str, ...]:
        """Return the overrides that set the numbers to ``values`` (P,)."""
        texts, at = {}, 0
        for path, array in zip(self.paths, self.arrays, strict=True):
            changed, moves = array.copy(), _moves(array)
            changed[moves] = values[at : at + int(moves.sum())]
            at += int(moves.sum())
            texts[path] = json.dumps(_round(changed.tolist()))
        return self.scenario.settings(texts)

    def at(self, values: Floats) -> LoadedScenario:
        """Return the scenario with other values (P,)."""
        return self.scenario.under(self.settings(values))


def _moves(array: Floats) -> Bools:
    return np.asarray((array != 0.0) | (not array.any()))


def _find(scenario: ParametricScenario, path: str) -> Floats:
    value = look_up(scenario.scenario.definition.resolved, path)
    if value is None:
        value = _network_array(scenario, path)
    try:
        numbers = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        numbers = np.zeros(0)
    if numbers.size == 0 or isinstance(value, (bool, str)):
        hint = "give the dotted path of a number, a list or a matrix, such as controller.v_goal_weight"
        raise UsageError(f"{scenario.path}: {path} has no numbers", hint)
    return numbers


def _network_array(scenario: ParametricScenario, path: str) -> object:
    controller = scenario.scenario.stack.loop.controller
    prefix = "controller.arrays."
    if controller is not None and controller.arrays and path.startswith(prefix):
        name = path.removeprefix(prefix)
        if name in controller.arrays:
            return controller.arrays[name]
        names = ", ".join(f"{prefix}{array}" for array in controller.arrays)
        raise UsageError(f"{scenario.path}: the controller has no array {name!r}", f"it has {names}")
    return float(scenario.value(path))  # says what is wrong


def _round(value: object) -> object:
    if isinstance(value, list):
        return [_round(entry) for entry in value]
    return float(f"{value:.8g}")
