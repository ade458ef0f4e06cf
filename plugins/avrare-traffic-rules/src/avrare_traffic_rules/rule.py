"""A traffic rule as a specification: predicates of each sample under a monitor."""

from __future__ import annotations

import re
from typing import Any

import numpy as np

from avrare.driving import Road, Scene
from avrare.errors import FormulaError, UsageError, did_you_mean
from avrare.logic import formula as f
from avrare.logic.algebra import Robustness
from avrare.logic.api import Formula
from avrare.logic.online import FormulaMonitor
from avrare.logic.robustness import Evaluator
from avrare.protocols import Floats, Signals, Verdict
from avrare_traffic_rules.check import read, require
from avrare_traffic_rules.config import Scales, TrafficRuleConfig
from avrare_traffic_rules.definitions import DEFINITIONS
from avrare_traffic_rules.traffic import read_traffic
from avrare_traffic_rules.vocabulary import Definitions, Predicate, Setting

_UNSCALED = Scales(longitudinal=1.0, lateral=1.0, speed=1.0, acceleration=1.0, heading=1.0, time=1.0)
_WORD = r"[^\W\d]\w*(\.[^\W\d]\w*)*"
_ALL_OTHERS = "write 'forall o in others: ...' and use o"


def build(config: TrafficRuleConfig, scene: Scene | None) -> TrafficRule:
    """The specification of a scenario.

    Raises:
        UsageError: The simulator has no road, an option speaks of lanes that it has not, or the formula is
            none; the messages are those of ``check``.
    """
    if scene is None:
        raise UsageError(
            f"rule {config.rule or config.formula!r} needs a driving simulator, with a road and vehicles",
            "write the rule as `stl:` instead",
        )
    return TrafficRule(config, scene)


class TrafficRule:
    """One rule (an ``avrare.protocols.Specification``).

    Attributes:
        formula: Over predicates of vehicles; its ``warnings`` say what looks odd.
        scene: The road and the vehicles.
        score: Name of the score that orders particles.
        names: The other vehicles that it speaks of, in the order of the predicates' axes.
        excluded: The other vehicles that it does not speak of, such as parked ones for R_G1.
    """

    def __init__(self, config: TrafficRuleConfig, scene: Scene) -> None:
        self.config = config
        self.scene = scene
        self.score = config.score
        _require_lanes(config, scene.road)
        self.formula = _formula(config, scene.dt)
        self._definitions = DEFINITIONS[config.definitions]
        self._setting = Setting(config, config.scales if self._definitions.scaled else _UNSCALED, scene.road)
        self._wanted = _look_up(self.formula.node, self._definitions, scene.names)
        default = "all" if config.rule is None else config.rulebook.rules[config.rule].vehicles
        which = config.vehicles or default
        self._chosen = scene.moving if which == "moving" else np.ones(len(scene.names), dtype=bool)
        self.names = tuple(name for name, chosen in zip(scene.names, self._chosen, strict=True) if chosen)
        asked = {name for _, names in self._wanted.values() for name in names}
        self.excluded = tuple(name for name in scene.names if name not in {*self.names, *asked})
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


def _require_lanes(config: TrafficRuleConfig, road: Road) -> None:
    lanes = len(road.lane_centres)
    hint = f"its lanes are 0 to {lanes - 1}, counted from the right"
    for lane in config.shoulder:
        if lane >= lanes:
            raise UsageError(f"shoulder: the road has no lane {lane}", hint)
    limit = config.lane_limit
    if isinstance(limit, tuple) and len(limit) != lanes:
        message = f"lane_limit has {len(limit)} entries, the road {lanes} lanes"
        raise UsageError(message, f"{hint}; write null where there is no limit")


def _formula(config: TrafficRuleConfig, dt: float) -> Formula:
    formula, findings = read(config, dt)
    require(findings)
    assert formula is not None  # it has no errors
    return formula


def _look_up(
    node: f.Node, definitions: Definitions, vehicles: tuple[str, ...]
) -> dict[str, tuple[Predicate, tuple[str, ...]]]:
    """Key of the samples -> the predicate and the vehicles or groups that it is asked about."""
    known = {"ego": "ego", "others": "others", **_spellings(vehicles)}
    wanted = {}
    for part in f.walk(node):
        if isinstance(part, f.Signal):
            name, _, inside = part.name.partition("(")
            words = [word.strip() for word in inside.rstrip(")").split(",")]
            for word in words:
                if word not in known:
                    raise FormulaError(
                        f"there is no vehicle {word!r}", did_you_mean(word, known) or _ALL_OTHERS
                    )
            wanted[part.name] = definitions.find(name, len(words)), tuple(known[word] for word in words)
    return wanted


def _spellings(vehicles: tuple[str, ...]) -> dict[str, str]:
    """Word of a formula -> vehicle; ``v7`` is the vehicle 7, unless another one has that name."""
    plain = {name: name for name in vehicles if re.fullmatch(_WORD, name)}
    spelt = ((f"v{name}", name) for name in vehicles if name not in plain)
    return {word: name for word, name in spelt if re.fullmatch(_WORD, word)} | plain
