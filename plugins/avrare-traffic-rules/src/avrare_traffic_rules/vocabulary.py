"""Predicates of formulas: names, arguments, units and functions.

A predicate is a function of a ``Setting`` and one ``Bodies`` per argument, whose arrays broadcast; it
returns values in its own unit. Predicates are positive where they hold and divided by the scale of their
kind, so that different ones compare. Quantities, for formulas of users, are not scaled.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from avrare.base.errors import FormulaError, did_you_mean
from avrare.driving import Road
from avrare.protocols import Floats
from avrare_traffic_rules.config import Parameters, Scales
from avrare_traffic_rules.traffic import Bodies, Extents, Lanes

UNITS = {
    "longitudinal": "m",
    "lateral": "m",
    "speed": "m/s",
    "acceleration": "m/s^2",
    "heading": "rad",
    "time": "s",
    "mixed": "",
}
"""Units by kind of scale; ``mixed`` predicates scale their parts themselves."""

Function = Callable[..., Floats]


@dataclass(frozen=True)
class Setting:
    """Arguments of predicates beside the vehicles.

    Attributes:
        parameters: Thresholds and times.
        scales: Units of robustness.
        road: The lanes.
        lights: Colours (N,) of the road's lights at this sample.
    """

    parameters: Parameters
    scales: Scales
    road: Road
    lights: tuple[Floats, ...] = ()

    @property
    def main_lanes(self) -> list[int]:
        """Lanes of the main carriageway, from right to left."""
        special_lanes = (*self.road.access_ramp, *self.shoulders, *self.road.opposing)
        return [lane for lane in range(len(self.road.lane_centres)) if lane not in special_lanes]

    @property
    def shoulders(self) -> list[int]:
        """Lanes that are a shoulder, by the road or by the option."""
        return sorted({*self.road.shoulder, *self.parameters.shoulder})

    def braking(self, bodies: Bodies) -> Floats:
        """Strongest braking of each vehicle [m/s^2]."""
        p = self.parameters
        return np.where(bodies.number < 0, p.ego_braking, p.others_braking)


@dataclass(frozen=True)
class Predicate:
    """A predicate or quantity.

    Attributes:
        name: Name in a formula.
        arguments: One name per vehicle.
        text: Meaning, in words.
        unit: Unit of the values of ``function``; empty for mixed ones, which are pure numbers.
        scale: Field of ``Scales`` that divides the values, ``mixed``, or empty for a quantity.
        function: ``(setting, *bodies) -> values``.
    """

    name: str
    arguments: tuple[str, ...]
    text: str
    unit: str
    scale: str
    function: Function

    def __call__(self, setting: Setting, *bodies: Bodies) -> Floats:
        """Return the scaled values."""
        values = self.function(setting, *bodies)
        return values / getattr(setting.scales, self.scale) if self.scale in Scales.model_fields else values


@dataclass(frozen=True)
class Definitions:
    """Complete set of meanings.

    Attributes:
        predicates: Predicates by name.
        extents: Function that gives front, rear and sides of a vehicle.
        lanes: Function that gives how far a vehicle is in each lane.
        scaled: True if predicates are scaled.
    """

    predicates: Mapping[str, Predicate]
    extents: Extents
    lanes: Lanes
    scaled: bool

    def find(self, name: str, count: int) -> Predicate:
        """Return the predicate ``name`` of ``count`` vehicles.

        Raises:
            FormulaError: There is none.
        """
        predicate = self.predicates.get(name)
        if predicate is None:
            hint = did_you_mean(name, self.predicates) or f"there are {', '.join(sorted(self.predicates))}"
            raise FormulaError(f"unknown predicate {name!r}", hint)
        arity = len(predicate.arguments)
        if arity != count:
            call = f"{name}({', '.join(predicate.arguments)})"
            plural = "s" if arity != 1 else ""
            raise FormulaError(
                f"{name} takes {arity} vehicle{plural}, not {count}", f"{call}: {predicate.text}"
            )
        return predicate


def predicate(scale: str) -> Callable[[Function], Predicate]:
    """Declare a function as a predicate of this kind of scale; its docstring's first line is its meaning."""
    return lambda function: _describe(function, UNITS[scale], scale)


def quantity(unit: str) -> Callable[[Function], Predicate]:
    """Declare a function as a quantity in this unit."""
    return lambda function: _describe(function, unit, "")


def find_predicates(module: Mapping[str, object]) -> dict[str, Predicate]:
    """Return the predicates of a module's namespace by name."""
    return {name: value for name, value in module.items() if isinstance(value, Predicate)}


def _describe(function: Function, unit: str, scale: str) -> Predicate:
    arguments = tuple(inspect.signature(function).parameters)[1:]
    text = (inspect.getdoc(function) or "").split("\n")[0]
    return Predicate(function.__name__, arguments, text, unit, scale, function)
