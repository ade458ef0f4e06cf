"""``avrare rules``: what it lists, and that a broken plugin breaks nothing."""

import json
import subprocess
import sys

import pytest

from avrare.cli import rules as command
from avrare.cli.main import main
from avrare.plugin import Component, RuleCard, RuleParameter, hookimpl
from avrare.plugin.registry import Registry

HEAVY = {"torch", "pyro", "casadi", "matplotlib", "plotly", "ray", "pandas", "numba", "gymnasium", "scipy"}
GRACE = RuleParameter("grace", "3", "s", "time to react", "[X20]")
PARTS = (GRACE, RuleParameter("mode", "calm", "", "how", ""))
FORMULA = "near(o) = gap(o) < 2\nalways not near(o)"
CARDS = [
    RuleCard("R_A", "keep away", "Keep away from [all] others.\n  Always.", FORMULA, PARTS, "[X20] part 2"),
    RuleCard("R_B", "stop", "Stop.", "eventually (speed < 0.1)", (), "ours"),
]


def cards():
    return CARDS


def nothing_but_trouble():
    raise RuntimeError("no\nrules")


def no_cards():
    return ["R_C"]


class Plugin:
    def __init__(self, name, rules):
        self.part = Component("specification", name, "json:JSONDecoder", "json:loads", "a test", rules=rules)

    @hookimpl
    def avrare_components(self):
        return [self.part]


@pytest.fixture
def offer(monkeypatch):
    """Install plugins whose rules come from functions of this module."""
    monkeypatch.setitem(sys.modules, "rules_of_the_tests", sys.modules[__name__])

    def offer(**functions):
        registry = Registry()
        for name, function in functions.items():
            reference = f"rules_of_the_tests:{function}" if function else ""
            registry.register(Plugin(name, reference), name, f"dist-{name}", "1.0")
        monkeypatch.setattr(command, "default_registry", lambda: registry)

    return offer


def test_the_table_names_every_rule(offer, capsys):
    offer(book="cards", other="")
    assert main(["rules"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split() for line in lines[2:4]] == [["R_A", "keep", "away", "book"], ["R_B", "stop", "book"]]


def test_a_card_shows_everything(offer, capsys):
    offer(book="cards")
    assert main(["rules", "R_A"]) == 0
    out = capsys.readouterr().out
    for words in (
        "R_A  keep away", "  Keep away from [all] others. Always.\n", "    near(o) = gap(o) < 2\n",
        "    always not near(o)\n", "  grace  3 s   time to react; [X20]\n", "  mode   calm  how\n",
        "plugin: book, dist-book 1.0", "source: [X20] part 2",
    ):  # fmt: skip
        assert words in out
    assert "R_B" not in out
    assert not [line for line in out.splitlines() if line != line.rstrip()]


def test_cards_as_json(offer, capsys):
    offer(book="cards")
    assert main(["rules", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert [card["name"] for card in found] == ["R_A", "R_B"]
    assert found[0]["parameters"][0] == {
        "name": "grace", "default": "3", "unit": "s", "text": "time to react", "source": "[X20]"
    }  # fmt: skip
    assert (found[0]["plugin"], found[0]["distribution"]) == ("book", "dist-book 1.0")
    assert main(["rules", "R_B", "--json"]) == 0
    assert [card["name"] for card in json.loads(capsys.readouterr().out)] == ["R_B"]


@pytest.mark.parametrize("names", [["ra"], ["r_a"], ["RA", "r-A"], ["R_A", "ra"]])
def test_case_and_underscores_do_not_matter(offer, capsys, names):
    offer(book="cards")
    assert main(["rules", "--json", *names]) == 0
    assert [card["name"] for card in json.loads(capsys.readouterr().out)] == ["R_A"]


def test_an_unknown_rule(offer, capsys):
    offer(book="cards")
    assert main(["rules", "R_AB"]) == 4
    assert capsys.readouterr().err == "unknown rule 'R_AB'\nhint: did you mean 'R_A' or 'R_B'?\n"
    assert main(["rules", "speed"]) == 4
    assert capsys.readouterr().err == "unknown rule 'speed'\nhint: 'avrare rules' lists them\n"
    offer()
    assert main(["rules", "R_a"]) == 5
    assert "pip install avrare-traffic-rules" in capsys.readouterr().err
    assert main(["rules"]) == 0
    assert "no installed plugin offers rules" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("function", "reason"),
    [
        ("nothing_but_trouble", "RuntimeError: no rules"),
        ("no_cards", "TypeError: it offers 'R_C', which is not a RuleCard"),
        ("no_such_function", "AttributeError"),
    ],
)
def test_a_broken_catalogue_is_a_warning(offer, capsys, function, reason):
    offer(bad=function, book="cards")
    assert main(["rules"]) == 0
    out, err = capsys.readouterr()
    assert "R_A" in out
    assert err.startswith("warning: the rules of bad (dist-bad 1.0) cannot be listed: ")
    assert reason in err
    assert err.count("\n") == 1


def test_an_invalid_reference_to_rules_is_reported():
    registry = Registry()
    registry.register(Plugin("odd", "no colon"), "odd", "dist-odd", "1.0")
    [row] = [row for row in registry.rows() if row.name == "odd"]
    assert "rules is 'no colon'" in row.detail


def test_listing_the_installed_rules_imports_nothing_heavy():
    code = "import sys; from avrare.cli.main import main; main(['rules', '--json']); print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    *text, modules = done.stdout.splitlines()
    assert not {name.split(".")[0] for name in modules.split()} & HEAVY
    names = [card["name"] for card in json.loads("\n".join(text))]
    assert {"R_G1", "R_G2", "R_G4", "R_I2", "no_collision"} <= set(names)
