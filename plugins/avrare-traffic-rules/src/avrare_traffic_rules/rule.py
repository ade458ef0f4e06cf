"""A traffic rule as a specification: predicates of each sample under a monitor."""

from __future__ import annotations

from typing import Any

import numpy as np

from avrare.driving import Scene
from avrare.errors import UsageError
from avrare.logic.api import Formula, stl
from avrare.logic.formula import Forall
from avrare.logic.online import FormulaMonitor
from avrare.protocols import Floats, Signals, Verdict
from avrare_traffic_rules.config import TrafficRuleConfig
from avrare_traffic_rules.formulas import text
from avrare_traffic_rules.predicates import Predicates
from avrare_traffic_rules.published import PublishedPredicates
from avrare_traffic_rules.traffic import read_traffic


def build(config: TrafficRuleConfig, scene: Scene | None) -> TrafficRule:
    """The specification of a scenario.

    Raises:
        UsageError: The simulator has no road.
    """
    if scene is None:
        raise UsageError(
            f"rule {config.rule} needs a driving simulator, with a road and vehicles",
            "write the rule as `stl:` instead",
        )
    return TrafficRule(config, scene)


class TrafficRule:
    """One rule (an ``avrare.protocols.Specification``).

    Attributes:
        formula: Over the predicates.
        score: Name of the score that orders particles.
    """

    def __init__(self, config: TrafficRuleConfig, scene: Scene) -> None:
        self.config = config
        self.scene = scene
        self.score = config.score
        self.formula: Formula = stl(text(config), dt=scene.dt)
        published = config.definitions == "published"
        self._predicates = PublishedPredicates(config) if published else Predicates(config)
        which = config.vehicles or ("moving" if config.rule == "R_G1" else "all")
        self._chosen = scene.moving if which == "moving" else np.ones(len(scene.names), dtype=bool)
        self._monitor = FormulaMonitor(self.formula)

    def start(self, n: int) -> Any:
        """Monitor state before sample 0."""
        return self._monitor.start(n)

    def update(self, state: Any, signals: Signals) -> tuple[Any, Verdict]:
        """Monitor state and verdict after one more sample of the simulator's signals."""
        return self._monitor.update(state, self.sample(signals))

    def margin(self, state: Any) -> Floats | None:
        """(N,) robustness of the rule's body at the newest sample."""
        return self._monitor.margin(state)

    def sample(self, signals: Signals) -> dict[str, Floats]:
        """The predicates that the formula reads, (N,) or (N, V)."""
        if self.config.rule == "no_collision":
            return {"distance": signals["distance"][:, self._chosen]}
        traffic = read_traffic(signals, self.scene, self._chosen, self._predicates.extents)
        n, vehicles = traffic.others.x.shape
        sample = {}
        for name in self.formula.signals:
            values = getattr(self._predicates, name)(traffic)
            sample[name] = values if values.ndim == 1 else np.broadcast_to(values, (n, vehicles))
        return sample

    def explain(self, signals: Signals) -> str:
        """What the first row's sample, taken as sample 0, comes nearest to failing on, in words.

        A rule for all others names the vehicle; in the rest the fault is the ego's and others only excuse it.
        """
        sample = {name: values[:1] for name, values in self.sample(signals).items()}
        names = [name for name, chosen in zip(self.scene.names, self._chosen, strict=True) if chosen]
        if not names or not isinstance(self.formula.node, Forall):
            return f"{self.config.rule} by the ego (robustness {self._robustness(sample):.3g})"
        alone = [
            self._robustness({k: x[:, v : v + 1] if x.ndim == 2 else x for k, x in sample.items()})
            for v in range(len(names))
        ]
        worst = int(np.argmin(alone))
        return f"{self.config.rule} with vehicle {names[worst]!r} (robustness {alone[worst]:.3g})"

    def _robustness(self, sample: Signals) -> float:
        return float(self._monitor.update(self._monitor.start(1), sample)[1].robustness[0])
