"""Descriptions of the rules, in cards and in the docs: they say what is computed."""

import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
import yaml

from avrare.logic.formula import stl
from avrare_traffic_rules.catalogue import rules
from avrare_traffic_rules.check import formula_text
from avrare_traffic_rules.config import Parameters, TrafficRuleConfig
from avrare_traffic_rules.definitions import RECOMMENDED
from avrare_traffic_rules.rulebook import read_shipped

CARDS = rules()
DOCS = Path(__file__).parents[3] / "docs"
EVERY = pytest.mark.parametrize("card", CARDS, ids=[card.name for card in CARDS])


class Recorder:
    """A config that remembers which parameters are read."""

    def __init__(self, config):
        self.config, self.read = config, set()

    def __getattr__(self, name):
        self.read.add(name)
        return getattr(self.config, name)


@EVERY
def test_the_card_shows_the_formula_that_is_monitored(card):
    assert card.formula == formula_text(TrafficRuleConfig(rule=card.name)).text
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # of doubtful readings
        assert stl(card.formula, dt=0.1).signals
    assert "{" not in card.text


@EVERY
def test_the_parameters_of_a_card_are_those_that_matter(card, lab):
    rule = lab.rule(card.name, 4, lane_limit=20.0)
    recorder = Recorder(rule.config)
    rule._setting = type(rule._setting)(recorder, rule._setting.scales, rule._setting.road)
    rule.sample(lab.random(np.random.default_rng(0), 5, 4))
    text = read_shipped().complete(read_shipped().rules[card.name].formula)
    filled = {name for name in Parameters.model_fields if f"{{{name}}}" in text}
    read = recorder.read - ({"others_braking"} if card.name == "R_G3" else set())  # asked of the ego alone
    assert {parameter.name for parameter in card.parameters} == read | filled


@EVERY
def test_defaults_are_as_a_scenario_writes_them(card):
    for parameter in card.parameters:
        written = yaml.safe_load(parameter.default)
        default = getattr(Parameters(), parameter.name)
        assert (tuple(written) if isinstance(written, list) else written) == default
        assert parameter.text
        assert parameter.source


def test_the_reference_page_shows_every_rule_and_predicate(tmp_path):
    subprocess.run([sys.executable, DOCS / "generate.py", tmp_path], check=True)
    page = (tmp_path / "reference" / "rules.md").read_text(encoding="utf-8")
    for card in CARDS:
        for text in (card.text, card.formula, card.remarks, f"rules/{card.name}.png"):
            assert text in page
        for p in card.parameters:
            assert f"| `{p.name}` | {p.default} | {p.unit} | {p.text} | {p.source} |" in page
    for name, predicate in RECOMMENDED.predicates.items():
        assert f"| `{name}({', '.join(predicate.arguments)})` | {predicate.text} |" in page


HEAVY = {"torch", "pyro", "casadi", "numba", "scipy", "matplotlib", "pandas", "plotly"}
CHECK = "; from avrare_traffic_rules.check import check; check(TrafficRuleConfig(rule='R_G1'), 0.1)"


@pytest.mark.parametrize(("check", "heavy"), [("", {"numpy", *HEAVY}), (CHECK, HEAVY)])
def test_the_catalogue_the_options_and_the_check_import_nothing_heavy(check, heavy):
    script = (
        "import sys; from avrare_traffic_rules.catalogue import rules; rules()\n"
        "from avrare_traffic_rules.config import TrafficRuleConfig; TrafficRuleConfig(rule='R_G1')"
        f"{check}; print(*sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert not {name.split(".")[0] for name in done.stdout.split()} & heavy
