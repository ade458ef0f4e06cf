"""Situations by hand and at random; every car is 4 m x 2 m, lanes lie at -1.75 (ramp), 1.75 and 5.25 m."""

import numpy as np
import pytest

from avrare.driving import Crossing, Road, Scene
from avrare.driving.reference_line import PolygonalLine
from avrare_traffic_rules.config import TrafficRuleConfig
from avrare_traffic_rules.rule import build

ACROSS = PolygonalLine(np.array([[-30.0, -9.0], [30.0, 9.0]]))
CROSSINGS = tuple(
    Crossing(reason, 2.0, 12.0, ACROSS, 30.0, 42.0, 3.0) for reason in ("right", "sign", "oncoming")
)
ROAD = Road((-1.75, 1.75, 5.25), 3.5, (0,), stop_signs=(4.0,), crossings=CROSSINGS, light_lines=(5.0,))
NAMES = "abcdefgh"
CALLS = (
    "brakes_abruptly(ego)", "preserves_flow(ego)", "on_access_ramp(ego)", "brakes(ego)", "slow({o})",
    "drives_faster(ego, {o})", "drives_slightly_faster(ego, {o})", "brakes_abruptly_relative(ego, {o})",
    "keeps_safe_distance(ego, {o})", "in_same_lane(ego, {o})", "in_slow_traffic({o})", "single_lane({o})",
    "on_main_carriageway({o})", "cut_in({o}, ego)", "in_front_of({o}, ego)", "precedes({o}, ego)",
    "left_of({o}, ego)",
)  # fmt: skip
CALL = {call.split("(")[0]: call for call in CALLS}
FIELDS = ("x", "y", "heading", "speed", "acceleration")
EGO = {"x": 0.0, "y": 1.75, "heading": 0.0, "speed": 20.0, "acceleration": 0.0}


class Lab:
    """Makes rules and what they read."""

    road = ROAD

    def rule(self, name, count=1, moving=None, road=ROAD, sizes=None, **options):
        """Build a rule over so many other vehicles, called a, b, c, ..."""
        moving = np.ones(count, dtype=bool) if moving is None else np.array(moving)
        names = tuple(NAMES[:count])
        lengths, widths = sizes or (np.full(count, 4.0), np.full(count, 2.0))
        scene = Scene(0.1, road, 4.0, 2.0, names, lengths, widths, moving)
        return build(TrafficRuleConfig(rule=name, **options), scene)

    def signals(self, *others, **ego):
        """Return one row: the ego drives at 20 m/s in the middle lane at x = 0 but for what is said."""
        signals = {f"ego_{name}": np.array([{**EGO, **ego}[name]]) for name in FIELDS}
        for name in FIELDS:
            values = [float({**EGO, **other}[name]) for other in others]
            signals[f"others_{name}"] = np.array(values).reshape(1, len(others))
        return {**signals, "light_0": np.zeros(1)}

    def value(self, predicate, *others, road=ROAD, options=None, **ego):
        """Evaluate a predicate or definition of the ego and each other vehicle (V,), or of one (1,)."""
        call, signals = CALL.get(predicate, predicate), self.signals(*others, **ego)
        formulas = [call.format(o=name) for name in NAMES[: len(others)]] if "{o}" in call else [call]
        rules = [self.rule(None, len(others), road=road, formula=one, **(options or {})) for one in formulas]
        return np.array([self.run(rule, [signals]).robustness[0] for rule in rules])

    def run(self, rule, samples):
        """Return the verdict after some samples, each of one row."""
        state, verdict = rule.start(1), None
        for signals in samples:
            state, verdict = rule.update(state, signals)
        return verdict

    def judge(self, rule, *others, **ego):
        """Return (violated, robustness) of a single sample."""
        verdict = self.run(rule, [self.signals(*others, **ego)])
        return bool(verdict.violated[0]), float(verdict.robustness[0])

    def random(self, rng, n, v):
        """Return signals of n rows: a crowd around the ego in which each predicate is true at times."""

        def vehicles(*shape):
            return {
                "x": rng.uniform(-25.0, 25.0, shape),
                "y": rng.choice([-1.75, 0.0, 1.75, 3.5, 5.25], shape) + rng.normal(0.0, 0.4, shape),
                "heading": rng.normal(0.0, 0.15, shape),
                "speed": rng.uniform(0.0, 40.0, shape),
                "acceleration": rng.normal(-3.0, 4.0, shape),
            }

        ego, others = vehicles(n), vehicles(n, v)
        signals = {f"ego_{name}": values for name, values in ego.items()}
        signals |= {f"others_{name}": values for name, values in others.items()}
        return {**signals, "light_0": rng.choice([0.0, 1.0, 2.0], n)}


@pytest.fixture(scope="session")
def lab():
    return Lab()


@pytest.fixture
def value(lab):
    def value(predicate, *others, **ego):
        found = lab.value(predicate, *others, **ego)
        return float(found[0]) if len(found) == 1 else found

    return value
