"""A traffic rule as a specification: predicates of each sample under a monitor."""

from __future__ import annotations

from typing import Any

import numpy as np

from avrare.driving import Scene
from avrare.errors import UsageError
from avrare.logic.api import Formula, stl
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
        traffic = read_traffic(signals, self.scene, self._chosen)
        n, vehicles = traffic.others.x.shape
        sample = {}
        for name in self.formula.signals:
            values = getattr(self._predicates, name)(traffic)
            sample[name] = values if values.ndim == 1 else np.broadcast_to(values, (n, vehicles))
        return sample

    def explain(self, signals: Signals) -> str:
        """Which vehicle the first row's sample fails on, in words."""
        sample = self.sample(signals)
        names = [name for name, chosen in zip(self.scene.names, self._chosen, strict=True) if chosen]
        if not names or all(values.ndim == 1 for values in sample.values()):
            return f"{self.config.rule}"
        alone = []
        for v in range(len(names)):
            single = {
                k: values[:1, v : v + 1] if values.ndim == 2 else values[:1] for k, values in sample.items()
            }
            alone.append(float(self._monitor.update(self._monitor.start(1), single)[1].robustness[0]))
        worst = int(np.argmin(alone))
        return f"{self.config.rule} with vehicle {names[worst]!r} (robustness {alone[worst]:.3g})"
