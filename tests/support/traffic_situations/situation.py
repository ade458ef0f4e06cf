"""Situation: a road, cars, and the robustness of a rule.

Cars are 4 m x 2 m. Lanes are 3.5 m wide; their centres lie at -1.75 (an access ramp), 1.75 and 5.25 m. A car
in the middle of a lane thus reaches 0.75 m short of the next one and 2.75 m into its own.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from avrare.driving import Road, Scene
from avrare.protocols import Floats, Signals
from avrare_traffic_rules.config import TrafficRuleConfig
from avrare_traffic_rules.rule import TrafficRule

Series = float | tuple[float, ...]
"""Number for all samples, or one per sample."""

RAMP, RIGHT, LEFT = -1.75, 1.75, 5.25
ROAD = Road((RAMP, RIGHT, LEFT), 3.5, (0,))
LENGTH, WIDTH = 4.0, 2.0


@dataclass(frozen=True)
class Car:
    """Car over time.

    Attributes:
        x: Centre [m]; a single number moves at the speed.
        y: Centre [m].
        speed: Speed [m/s].
        heading: Heading [rad].
        acceleration: Acceleration [m/s^2].
        moving: False for a parked car.
    """

    x: Series = 0.0
    y: Series = RIGHT
    speed: float = 20.0
    heading: Series = 0.0
    acceleration: float = 0.0
    moving: bool = True

    def over(self, steps: int, dt: float) -> dict[str, Floats]:
        """Return every quantity as an array (steps,)."""
        run = self.speed * dt * np.arange(steps)
        x = np.array(self.x) if isinstance(self.x, tuple) else self.x + run
        known = {"x": x, **{name: getattr(self, name) for name in ("y", "speed", "heading", "acceleration")}}
        return {name: np.broadcast_to(np.asarray(value, float), (steps,)) for name, value in known.items()}


@dataclass(frozen=True)
class Situation:
    """Cars and the robustness of a rule.

    Attributes:
        rule: Name of the rule.
        kind: ``pass``, ``fail``, ``boundary`` (robustness 0) or ``exempt`` (an exception applies).
        title: A few words.
        value: Robustness after the last sample, calculated by hand.
        because: The calculation.
        ego: The vehicle under test.
        others: Other cars by name.
        steps: Number of samples.
        dt: Time between samples [s].
        road: The lanes.
        options: Options of the rule.
        light: Colours of the road's traffic light: 0 green, 1 yellow, 2 red.
        nudge: At a boundary: car, quantity, and sign of the change that satisfies the rule.
    """

    rule: str
    kind: Literal["pass", "fail", "boundary", "exempt"]
    title: str
    value: float
    because: str
    ego: Car = field(default_factory=Car)
    others: Mapping[str, Car] = field(default_factory=dict)
    steps: int = 1
    dt: float = 1.0
    road: Road = ROAD
    options: Mapping[str, Any] = field(default_factory=dict)
    light: tuple[float, ...] = ()
    nudge: tuple[str, str, int] = ("", "", 0)

    def specification(self) -> TrafficRule:
        """Build the rule."""
        count = len(self.others)
        moving = np.array([car.moving for car in self.others.values()], dtype=bool)
        sizes = np.full(count, LENGTH), np.full(count, WIDTH)
        scene = Scene(self.dt, self.road, LENGTH, WIDTH, tuple(self.others), *sizes, moving)
        return TrafficRule(TrafficRuleConfig(rule=self.rule, **self.options), scene)

    def signals(self) -> list[Signals]:
        """Return the signals of one particle at each sample."""
        ego = self.ego.over(self.steps, self.dt)
        others = [car.over(self.steps, self.dt) for car in self.others.values()]
        return [
            {f"ego_{name}": ego[name][t : t + 1] for name in ego}
            | {f"others_{name}": np.array([[car[name][t] for car in others]]) for name in ego}
            | ({"light_0": np.array([self.light[t]])} if self.light else {})
            for t in range(self.steps)
        ]

    def evaluate(self) -> tuple[float, bool]:
        """Return the robustness after the last sample, and whether the rule is violated."""
        rule = self.specification()
        state = rule.start(1)
        for signals in self.signals():
            state, verdict = rule.update(state, signals)
        return float(verdict.robustness[0]), bool(verdict.violated[0])

    def nudged(self, amount: float) -> Situation:
        """Return the situation with ``nudge`` applied; a positive amount satisfies the rule."""
        name, quantity, sign = self.nudge
        car = self.ego if name == "ego" else self.others[name]
        old = getattr(car, quantity)
        change = sign * amount
        new = tuple(value + change for value in old) if isinstance(old, tuple) else old + change
        changed: dict[str, Any] = {quantity: new}
        moved = dataclasses.replace(car, **changed)
        if name == "ego":
            return dataclasses.replace(self, ego=moved)
        return dataclasses.replace(self, others={**self.others, name: moved})
