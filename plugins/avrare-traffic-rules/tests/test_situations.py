"""The hand-made situations of every rule: value and verdict as worked out on paper."""

import numpy as np
import pytest

from avrare_traffic_rules.rulebook import read_shipped
from traffic_situations import SITUATIONS

IDS = [f"{situation.rule}: {situation.title}" for situation in SITUATIONS]
BOUNDARIES = [situation for situation in SITUATIONS if situation.kind == "boundary"]


@pytest.mark.parametrize("situation", SITUATIONS, ids=IDS)
def test_robustness(situation):
    value, violated = situation.evaluate()
    assert value == pytest.approx(situation.value, abs=1e-9)
    if situation.kind != "boundary":
        assert violated == (situation.kind == "fail")
        assert (value < 0.0) == violated


@pytest.mark.parametrize("situation", BOUNDARIES, ids=[situation.rule for situation in BOUNDARIES])
def test_a_micrometre_across_the_boundary_changes_the_verdict(situation):
    assert abs(situation.evaluate()[0]) < 1e-9
    for amount in (1e-6, -1e-6):
        value, violated = situation.nudged(amount).evaluate()
        assert violated == (amount < 0.0)
        assert np.sign(value) == np.sign(amount)
        assert abs(value) < 1e-4


@pytest.mark.parametrize("rule", read_shipped().rules)
def test_every_rule_has_all_kinds(rule):
    found = {situation.kind for situation in SITUATIONS if situation.rule == rule}
    assert found == {"pass", "fail", "boundary", "exempt"}


def test_titles_of_situations_are_unique():
    assert len(set(IDS)) == len(IDS)
