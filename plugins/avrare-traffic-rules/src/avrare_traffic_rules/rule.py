"""Traffic rule as a specification: predicates of each sample, and a robustness monitor over them."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping

import numpy as np

from avrare.base.errors import FormulaError, UsageError, did_you_mean
from avrare.driving import Road, Scene
from avrare.logic.formula import FormulaMonitor
from avrare.logic.monitor.monitors import MonitorState
from avrare.logic.semantics.trace_evaluator import Evaluator
from avrare.logic.semantics.value_algebra import RobustnessAlgebra
from avrare.logic.syntax import nodes
from avrare.protocols import Floats, Signals, Specification, Verdict
from avrare_traffic_rules.check import parse_rule, raise_errors
from avrare_traffic_rules.config import Scales, TrafficRuleConfig
from avrare_traffic_rules.definitions import DEFINITIONS, PLAIN, WITHOUT_LANES
from avrare_traffic_rules.intersections import LIT
from avrare_traffic_rules.rulebook import fill
from avrare_traffic_rules.traffic import read_lights, read_traffic
from avrare_traffic_rules.vocabulary import Definitions, Predicate, Setting

_WORD = r"[^\W\d]\w*(\.[^\W\d]\w*)*"


def build(config: TrafficRuleConfig, scene: Scene | None) -> TrafficRule:
    """Build the specification of a scenario.

    Raises:
        UsageError: The simulator has no road, an option names a lane that does not exist, or the formula is
            invalid; the messages are those of ``check``.
    """
    if scene is None:
        raise UsageError(
            f"rule {config.rule or config.formula!r} needs a driving simulator, with a road and vehicles",
            "write the rule as `stl:` instead",
        )
    return TrafficRule(config, scene)


class TrafficRule(Specification):
    """One rule.

    Attributes:
        formula: Formula over predicates of vehicles, with its ``warnings``.
        scene: The road and the vehicles.
        score: Name of the score that orders particles.
        names: The other vehicles that it refers to, in the order of the predicates' axes.
        excluded: The other vehicles, such as parked ones for R_G1.
        words: The rule in English, with its own parameters; empty for a formula of the scenario.
    """

    def __init__(self, config: TrafficRuleConfig, scene: Scene) -> None:
        self.config = config
        self.scene = scene
        self.score = config.score
        _require_lanes(config, scene.road)
        formula, findings = parse_rule(config, scene.dt)
        raise_errors(findings)
        assert formula is not None  # it has no errors
        self.formula = formula
        self._definitions = DEFINITIONS[config.definitions]
        unscaled = Scales(longitudinal=1.0, lateral=1.0, speed=1.0, acceleration=1.0, heading=1.0, time=1.0)
        self._setting = Setting(config, config.scales if self._definitions.scaled else unscaled, scene.road)
        self._predicates = _look_up(self.formula.node, self._definitions, scene.names)
        if not scene.road.lane_centres:
            _require_no_lanes(config, self._predicates)
        asks = {predicate.name for predicate, _ in self._predicates.values()}
        self._lit = bool(scene.road.light_lines) and not asks.isdisjoint(LIT)
        rule = None if config.rule is None else config.rulebook.rules[config.rule]
        self.words = "" if rule is None else fill(rule.text, config.model_dump())
        which = config.vehicles or ("all" if rule is None else rule.vehicles)
        self._chosen = scene.moving if which == "moving" else np.ones(len(scene.names), dtype=bool)
        self.names = tuple(name for name, chosen in zip(scene.names, self._chosen, strict=True) if chosen)
        asked = {name for _, names in self._predicates.values() for name in names}
        self.excluded = tuple(name for name in scene.names if name not in {*self.names, *asked})
        self._monitor = FormulaMonitor(self.formula)

    def start(self, n: int) -> MonitorState:
        """Return the monitor state before sample 0."""
        return self._monitor.start(n)

    def update(self, state: MonitorState, signals: Signals) -> tuple[MonitorState, Verdict]:
        """Return monitor state and verdict after one more sample of the simulator's signals."""
        return self._monitor.update(state, self.sample(signals))

    def margin(self, state: MonitorState) -> Floats | None:
        """Return the (N,) robustness of the rule's body at the newest sample; None if it looks ahead."""
        return self._monitor.margin(state)

    def sample(self, signals: Signals) -> dict[str, Floats]:
        """Evaluate the predicates of the formula: (N,), and an axis (V,) for each argument ``others``."""
        definitions = self._definitions
        traffic = read_traffic(signals, self.scene, self._chosen, definitions.extents, definitions.lanes)
        setting, sample = self._setting, {}
        if self._lit:
            setting = dataclasses.replace(setting, lights=read_lights(signals, self.scene.road))
        for key, (predicate, names) in self._predicates.items():
            bodies, shape = traffic.arguments(names)
            sample[key] = np.broadcast_to(predicate(setting, *bodies), shape)
        return sample

    def explain(self, signals: Signals) -> str:
        """Describe what the first row's sample, taken as sample 0, is nearest to violating.

        A rule for all others names the vehicle; any other rule is violated by the ego, others only excuse it.
        """
        title = self.config.rule or "the formula"
        samples = {key: values[None, :1] for key, values in self.sample(signals).items()}
        evaluate = Evaluator(samples, 1, 1, RobustnessAlgebra(), self.formula.closed)
        node = self.formula.node
        if not (self.names and isinstance(node, nodes.Quantifier) and node.op == "forall"):
            return f"{title} by the ego (robustness {evaluate(node)[0, 0]:.3g})"
        each = evaluate(node.child)[0, 0]
        worst = int(np.argmin(each))
        return f"{title} with vehicle {self.names[worst]!r} (robustness {each[worst]:.3g})"


def _require_lanes(config: TrafficRuleConfig, road: Road) -> None:
    lanes = len(road.lane_centres)
    hint = f"its lanes are 0 to {lanes - 1}, counted from the right"
    for lane in config.shoulder:
        if lane >= lanes:
            raise UsageError(f"shoulder: the road has no lane {lane}", hint)
    limit = config.lane_limit
    if isinstance(limit, tuple) and len(limit) != lanes:
        message = f"lane_limit has {len(limit)} entries, the road {lanes} lanes"
        raise UsageError(message, f"{hint}; write null for a lane without a limit")


def _require_no_lanes(
    config: TrafficRuleConfig, predicates: Mapping[str, tuple[Predicate, tuple[str, ...]]]
) -> None:
    # in the plane of an intersection there is no x along the road
    for call, (predicate, _) in predicates.items():
        if predicate.name not in WITHOUT_LANES:
            raise UsageError(
                f"rule {config.rule or config.formula!r} reads {call}, and this simulator has no lanes",
                f"an intersection has rules of its own, and {', '.join(sorted(PLAIN))}",
            )


def _look_up(
    node: nodes.Node, definitions: Definitions, vehicles: tuple[str, ...]
) -> dict[str, tuple[Predicate, tuple[str, ...]]]:
    spellings = {"ego": "ego", "others": "others", **_spellings(vehicles)}
    meanings = {}
    all_others = "write 'forall o in others: ...' and use o"
    for part in nodes.walk(node):
        if isinstance(part, nodes.Signal):
            name, _, inside = part.name.partition("(")
            words = [word.strip() for word in inside.rstrip(")").split(",")]
            for word in words:
                if word not in spellings:
                    raise FormulaError(
                        f"unknown vehicle {word!r}", did_you_mean(word, spellings) or all_others
                    )
            meanings[part.name] = definitions.find(name, len(words)), tuple(spellings[word] for word in words)
    return meanings


def _spellings(vehicles: tuple[str, ...]) -> dict[str, str]:
    plain = {name: name for name in vehicles if re.fullmatch(_WORD, name)}
    # v7 is the vehicle 7, unless another one has that name
    spelt = ((f"v{name}", name) for name in vehicles if name not in plain)
    return {word: name for word, name in spelt if re.fullmatch(_WORD, word)} | plain
