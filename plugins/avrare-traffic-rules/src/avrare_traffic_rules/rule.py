"""A traffic rule as a specification: predicates of each sample under a monitor."""

from __future__ import annotations

from typing import Any

import numpy as np

from avrare.driving import Scene
from avrare.errors import FormulaError, UsageError, did_you_mean
from avrare.logic import formula as f
from avrare.logic.algebra import Robustness
from avrare.logic.api import Formula, stl
from avrare.logic.online import FormulaMonitor
from avrare.logic.robustness import Evaluator
from avrare.protocols import Floats, Signals, Verdict
from avrare_traffic_rules.config import Scales, TrafficRuleConfig
from avrare_traffic_rules.definitions import DEFINITIONS
from avrare_traffic_rules.rulebook import fill
from avrare_traffic_rules.traffic import read_traffic
from avrare_traffic_rules.vocabulary import Definitions, Predicate, Setting

_UNSCALED = Scales(longitudinal=1.0, lateral=1.0, speed=1.0, acceleration=1.0, heading=1.0, time=1.0)
_ALL_OTHERS = "write 'forall o in others: ...' and use o"


def build(config: TrafficRuleConfig, scene: Scene | None) -> TrafficRule:
    """The specification of a scenario.

    Raises:
        UsageError: The simulator has no road, or the formula is none.
    """
    if scene is None:
        raise UsageError(
            f"rule {config.rule or config.formula!r} needs a driving simulator, with a road and vehicles",
            "write the rule as `stl:` instead",
        )
    return TrafficRule(config, scene)


def text(config: TrafficRuleConfig) -> str:
    """The formula of a configuration, below the definitions that it uses, with its parameters filled in."""
    book = config.rulebook
    formula = config.formula
    if formula is None:
        rule = book.rules[config.rule or ""]
        formula = (rule.published if config.definitions == "published" else None) or rule.formula
    return fill(book.complete(formula), config.model_dump())


class TrafficRule:
    """One rule (an ``avrare.protocols.Specification``).

    Attributes:
        formula: Over predicates of vehicles.
        scene: The road and the vehicles.
        score: Name of the score that orders particles.
        names: The other vehicles that it speaks of, in the order of the predicates' axes.
    """

    def __init__(self, config: TrafficRuleConfig, scene: Scene) -> None:
        self.config = config
        self.scene = scene
        self.score = config.score
        self.formula: Formula = stl(text(config), dt=scene.dt)
        self._definitions = DEFINITIONS[config.definitions]
        self._setting = Setting(config, config.scales if self._definitions.scaled else _UNSCALED, scene.road)
        self._wanted = _look_up(self.formula.node, self._definitions, scene.names)
        default = "all" if config.rule is None else config.rulebook.rules[config.rule].vehicles
        which = config.vehicles or default
        self._chosen = scene.moving if which == "moving" else np.ones(len(scene.names), dtype=bool)
        self.names = tuple(name for name, chosen in zip(scene.names, self._chosen, strict=True) if chosen)
        self._monitor = FormulaMonitor(self.formula)

    def start(self, n: int) -> Any:
        """Monitor state before sample 0."""
        return self._monitor.start(n)

    def update(self, state: Any, signals: Signals) -> tuple[Any, Verdict]:
        """Monitor state and verdict after one more sample of the simulator's signals."""
        return self._monitor.update(state, self.sample(signals))

    def margin(self, state: Any) -> Floats | None:
        """(N,) robustness of the rule's body at the newest sample; None where it looks ahead."""
        return self._monitor.margin(state)

    def sample(self, signals: Signals) -> dict[str, Floats]:
        """The predicates that the formula reads: (N,), and an axis (V,) for each argument ``others``."""
        meanings = self._definitions
        traffic = read_traffic(signals, self.scene, self._chosen, meanings.extents, meanings.lanes)
        sample = {}
        for key, (predicate, names) in self._wanted.items():
            bodies, shape = traffic.arguments(names)
            sample[key] = np.broadcast_to(predicate(self._setting, *bodies), shape)
        return sample

    def explain(self, signals: Signals) -> str:
        """What the first row's sample, taken as sample 0, comes nearest to failing on, in words.

        A rule for all others names the vehicle; in the rest the fault is the ego's and others only excuse it.
        """
        title = self.config.rule or "the formula"
        samples = {key: values[None, :1] for key, values in self.sample(signals).items()}
        evaluate = Evaluator(samples, 1, 1, Robustness(), self.formula.closed)
        node = self.formula.node
        if not (self.names and isinstance(node, f.Quantifier) and node.op == "forall"):
            return f"{title} by the ego (robustness {evaluate(node)[0, 0]:.3g})"
        each = evaluate(node.child)[0, 0]
        worst = int(np.argmin(each))
        return f"{title} with vehicle {self.names[worst]!r} (robustness {each[worst]:.3g})"


def _look_up(
    node: f.Node, definitions: Definitions, vehicles: tuple[str, ...]
) -> dict[str, tuple[Predicate, tuple[str, ...]]]:
    """Key of the samples -> the predicate and the vehicles or groups that it is asked about."""
    wanted = {}
    for part in f.walk(node):
        if isinstance(part, f.Quantifier) and part.group != "others":
            raise FormulaError(f"there is no group of vehicles {part.group!r}", "quantify over 'others'")
        if isinstance(part, f.Signal):
            if not part.arguments:
                hint = did_you_mean(part.name, definitions.predicates)
                raise FormulaError(
                    f"{part.name!r} is asked about no vehicle", hint or "write speed(ego), not speed"
                )
            name = part.name.split("(")[0]
            predicate = definitions.find(name, len(part.arguments))
            wanted[part.name] = predicate, _groups(part, vehicles)
    return wanted


def _groups(signal: f.Signal, vehicles: tuple[str, ...]) -> tuple[str, ...]:
    groups = tuple(word.strip() for word in signal.name.partition("(")[2].rstrip(")").split(","))
    known = ("ego", "others", *vehicles)
    for group in groups:
        if group not in known:
            raise FormulaError(f"there is no vehicle {group!r}", did_you_mean(group, known) or _ALL_OTHERS)
    return groups
