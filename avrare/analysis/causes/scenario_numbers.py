"""Numbers of a scenario that change together: single ones, lists, matrices, and arrays of a network."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from avrare.analysis.causes.scenario_parameters import ParametricScenario
from avrare.base.errors import UsageError
from avrare.protocols import Floats, find_ability
from avrare.rollout.loaded_scenario import LoadedScenario, load

_ARRAYS = "controller.arrays."


class HasArrays(Protocol):
    """Controller of arrays of numbers by name, such as a network's; its option ``arrays`` replaces them."""

    arrays: Mapping[str, Any]


@dataclass(frozen=True)
class ScenarioNumbers:
    """P numbers of a scenario.

    Attributes:
        scenario: The scenario.
        paths: Dotted paths, each of a number, a list or a matrix.
        shapes: Their shapes; () for a number.
        start: (P,) values in the scenario.
    """

    scenario: ParametricScenario
    paths: tuple[str, ...]
    shapes: tuple[tuple[int, ...], ...]
    start: Floats

    @staticmethod
    def of(scenario: ParametricScenario, paths: Sequence[str]) -> ScenarioNumbers:
        """Find the numbers; UsageError where a path has none."""
        values = [_find(scenario, path) for path in dict.fromkeys(paths)]
        flat = np.concatenate([value.reshape(-1) for value in values])
        return ScenarioNumbers(
            scenario, tuple(dict.fromkeys(paths)), tuple(value.shape for value in values), flat
        )

    @property
    def names(self) -> tuple[str, ...]:
        """Dotted path of each number (P,)."""
        return tuple(name for path, shape in zip(self.paths, self.shapes, strict=True)
                     for name in _entry_names(path, shape))  # fmt: skip

    @property
    def scale(self) -> Floats:
        """(P,) the unit in which each number moves: its size; of a 0 that of its array, or else 1."""
        sizes = []
        for part in self._parts(self.start):
            whole = float(np.sqrt(np.mean(part**2))) or 1.0
            sizes.append(np.where(part == 0.0, whole, np.abs(part)).reshape(-1))
        return np.concatenate(sizes)

    def settings(self, values: Floats) -> tuple[str, ...]:
        """Return the overrides that set the numbers to ``values`` (P,)."""
        parts = zip(self.paths, self._parts(values), strict=True)
        return tuple(f"{path}={json.dumps(_rounded(part.tolist()))}" for path, part in parts)

    def at(self, values: Floats) -> LoadedScenario:
        """Return the scenario with other values (P,)."""
        return load(self.scenario.path, (*self.scenario.overrides, *self.settings(values)))

    def _parts(self, values: Floats) -> Iterator[Floats]:
        at = 0
        for shape in self.shapes:
            size = int(np.prod(shape))
            yield np.asarray(values[at : at + size]).reshape(shape)
            at += size


def _find(scenario: ParametricScenario, path: str) -> Floats:
    value: Any = scenario.scenario.definition.resolved
    for key in path.split("."):
        if isinstance(value, dict) and key in value:
            value = value[key]
        elif isinstance(value, list) and key.isdigit() and int(key) < len(value):
            value = value[int(key)]
        else:
            value = _network_array(scenario, path)
            break
    try:
        found = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        found = np.zeros(0)
    if found.size == 0 or isinstance(value, (bool, str)):
        hint = "give the dotted path of a number, a list or a matrix, such as controller.v_goal_weight"
        raise UsageError(f"{scenario.path}: {path} has no numbers", hint)
    return found


def _network_array(scenario: ParametricScenario, path: str) -> Any:
    controller = getattr(scenario.scenario.stack.loop, "controller", None)
    holder = find_ability(controller, HasArrays)
    if holder is not None and path.startswith(_ARRAYS):
        name = path.removeprefix(_ARRAYS)
        if name in holder.arrays:
            return holder.arrays[name]
        known = ", ".join(f"{_ARRAYS}{one}" for one in holder.arrays)
        raise UsageError(f"{scenario.path}: the controller has no array {name!r}", f"it has {known}")
    return float(scenario.value(path))  # says what is wrong


def _entry_names(path: str, shape: tuple[int, ...]) -> list[str]:
    return [".".join((path, *map(str, index))) for index in np.ndindex(*shape)]


def _rounded(value: Any) -> Any:
    if isinstance(value, list):
        return [_rounded(one) for one in value]
    return float(f"{value:.8g}")
