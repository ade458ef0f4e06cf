"""Mistakes told without a road, and the same ones when a rule is built."""

import warnings

import pytest

from avrare.base.errors import FormulaError
from avrare.plugin import Finding
from avrare_traffic_rules.check import check, raise_errors
from avrare_traffic_rules.config import TrafficRuleConfig
from avrare_traffic_rules.rulebook import read_shipped

FILE = """\
definitions: |
  behind(a, b) = in_same_lane(a, b) and
    in_front_of(b, a)
  wrong(a) = speed(a) > > 3
rules:
  push:
    formula: "forall o in others: always (behind(o, ego) -> gap(o, ego) > 5)"
  bent:
    formula: "always (speed(ego) > {speed_limitt}) and {gap} > {lane_limit}"
  unread:
    formula: "always wrong(ego)"
"""


MARKED = "  always slow(ego) -> )\n" + " " * 22 + "^"


@pytest.fixture
def mine(tmp_path):
    def write(text=FILE):
        path = tmp_path / "mine.yaml"
        path.write_text(text)
        return path

    return write


def told(dt=0.1, **options):
    """Return the only finding, which is also what building says."""
    (finding,) = check(TrafficRuleConfig(**options), dt)
    return finding


@pytest.mark.parametrize("dt", [0.1, None])
@pytest.mark.parametrize("definitions", ["recommended", "published"])
@pytest.mark.parametrize("rule", read_shipped().rules)
def test_the_shipped_rules_have_no_findings(rule, definitions, dt):
    assert check(TrafficRuleConfig(rule=rule, definitions=definitions), dt) == []


@pytest.mark.parametrize(
    ("formula", "message", "hint"),
    [
        # the definitions above it do not count as lines, and the mark is below the place
        (
            "always slow(ego) -> )",
            f"line 1, column 21: unexpected ')': an operand is missing\n{MARKED}",
            None,
        ),
        ("fast = speed(ego) > 3\nalways (fast and", "line 2, column 17: the formula ends early", None),
        ("always in_frontof(ego, ego)", "unknown predicate 'in_frontof'", "did you mean 'in_front_of'?"),
        ("always speed(ego, ego) > 1", "speed takes 1 vehicle, not 2", "speed(a): Speed of a along"),
        ("always speed > 1", "'speed' has no vehicle as its argument", "did you mean 'speed'?"),
        ("forall o in cars: always slow(o)", "unknown group of vehicles", "quantify over 'others'"),
        ("always ahead(ego)", "line 1, column 8: ahead takes 2 arguments, not 1", "ahead(a, b)"),
        ("always speed(ego) > {speed_limitt}", "{speed_limitt} is not an", "did you mean 'speed_limit'?"),
        ("always speed(ego) > {lane_limit}", "the option lane_limit is not a number", None),
        ("always[0,0.25s] speed(ego) > 1", "line 1, column 10: 0.25 s is not a whole multiple", "0.2 s"),
    ],
)
def test_mistakes_in_a_formula(lab, formula, message, hint):
    finding = told(formula=formula)
    assert finding.message.startswith(message)
    assert hint is None or hint in finding.hint
    assert (finding.option, finding.is_error) == ("formula", True)
    with pytest.raises(FormulaError) as error:
        lab.rule(None, 1, formula=formula)
    assert (error.value.message, error.value.hint) == (finding.message, finding.hint)


def test_several_mistakes_are_reported_together(lab):
    formula = "always (in_frontof(ego, ego) and speed(ego, ego) > 1 and in_frontof(ego, ego))"
    assert len(check(TrafficRuleConfig(formula=formula), 0.1)) == 2
    with pytest.raises(
        FormulaError, match=r"unknown predicate 'in_frontof'\nhint: .*\nspeed takes 1 vehicle"
    ):
        lab.rule(None, 1, formula=formula)


class TestBounds:
    @pytest.mark.parametrize(
        ("rule", "option", "value"), [("R_G1", "cut_in_time", 0.25), ("R_I5", "entering_time", 1.01)]
    )
    def test_an_option_between_samples_is_named(self, lab, rule, option, value):
        finding = told(rule=rule, **{option: value})
        wanted = f"{value:g} s is not a whole multiple of dt = 0.1 s (option {option})"
        assert (finding.message, finding.option) == (wanted, option)
        assert finding.hint.startswith("the nearest sample is at")
        with pytest.raises(FormulaError) as error:
            lab.rule(rule, **{option: value})
        assert error.value.message == wanted

    def test_an_option_is_distinguished_from_an_equal_number(self):
        formula = "always[0,0.25s] (once[0,{cut_in_time}s] speed(ego) > 1)"
        assert told(formula=formula, cut_in_time=0.25).option == "formula"
        assert told(formula=formula.replace("0.25", "0.2"), cut_in_time=0.25).option == "cut_in_time"

    def test_options_that_are_not_bounds_are_not_checked(self):
        config = TrafficRuleConfig(formula="always speed(ego) < {speed_limit}", speed_limit=0.123)
        assert check(config, 0.1) == []


class TestWarnings:
    FORMULA = "forall o in others: always ahead(o, ego) and speed(ego) > 1"

    def test_warnings_are_findings_but_not_errors(self):
        finding = told(formula=self.FORMULA)
        assert finding.message.startswith("line 1, column 21: always binds tighter than and")
        assert not finding.is_error
        raise_errors([finding])

    def test_warnings_come_with_the_rule_and_not_as_python_warnings(self, lab):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            rule = lab.rule(None, 1, formula=self.FORMULA)
        (complaint,) = rule.formula.warnings
        assert (complaint.message, complaint.hint) == (told(formula=self.FORMULA).message, complaint.hint)


class TestRulesFiles:
    def test_an_unknown_rule_error_still_lists_the_choices(self, mine):
        with pytest.raises(ValueError, match="'push', 'bent', 'unread'"):
            TrafficRuleConfig(rule="pushh", rules_file=mine())

    def test_options_in_braces(self, mine):
        findings = check(TrafficRuleConfig(rule="bent", rules_file=mine()), 0.1)
        begins = [finding.message.split("}")[0][:30] for finding in findings]
        assert begins == ["{speed_limitt", "{gap", "the option lane_limit is not a"]
        assert {finding.option for finding in findings} == {"rules_file"}

    @pytest.mark.parametrize(
        ("lines", "message"),
        [
            (["a(p, q) = a(p, q)"], "in the definition of a, column 11: a uses itself"),
            (["a(p, q) = b(p, q)", "b(p, q) = a(p, q)"], "of a, column 11: b is defined below"),
            ([f"a{i}(p, q) = a{i - 1}(p, q)" for i in range(1, 2000)], "nested"),
        ],
        ids=["itself", "each other", "a long chain"],
    )
    def test_definitions_that_use_each_other(self, mine, lines, message):
        formula = f"exists o in others: {lines[-1].partition('(')[0]}(ego, o)"
        indented = "\n  ".join(["a0(p, q) = ahead(p, q)", *lines])
        path = mine(f"definitions: |\n  {indented}\nrules:\n  mine: {{formula: '{formula}'}}\n")
        assert message in told(rule="mine", rules_file=path).message

    def test_a_mistake_in_a_definition(self, mine):
        path = mine()
        finding = told(rule="unread", rules_file=path)
        assert finding.message.startswith(f"{path}: rules.unread: in the definition of wrong, column ")
        assert "wrong(a) = speed(a) > > 3" in finding.message

    @pytest.mark.slow
    @pytest.mark.parametrize(
        ("text", "message", "hint"),
        [
            ("", "mine.yaml:1:1: the file is empty", "NAME"),
            ("rules: [\n", "mine.yaml:2:1: not YAML: ", "NAME"),
            ("definitions: a(b) = c\n", "mine.yaml:1:1: rules: required, but missing", "NAME"),
            ("rules:\n  push: 3\n", "mine.yaml:2:9: rules.push: should be a mapping, found 3", "formula"),
            ("rules:\n  push: {formul: x}\n", "mine.yaml:2:10: rules.push.formul: unknown key", "'formula'"),
            ("rule: {}\n", "mine.yaml:1:1: rule: unknown key", "'rules'"),
            ("rules: {push: {formula: x, vehicles: 1}}", "rules.push.vehicles: should be 'moving' or", ""),
            ("definitions: no\nrules: {push: {formula: x}}", "mine.yaml: definitions: 'no'", "write"),
            ("definitions: a(b) = c((b)\nrules: {push: {formula: x}}", "definitions.a: brackets do", ""),
        ],
    )
    @pytest.mark.parametrize("asked", [{"rule": "push"}, {"formula": "always speed(ego) > 1"}])
    def test_mistakes_in_a_rules_file(self, lab, mine, asked, text, message, hint):
        path = mine(text)
        finding = told(**asked, rules_file=path)
        assert message in finding.message
        assert finding.message.startswith(str(path))
        assert "\n" not in finding.message
        for leaked in ("RulesFile", "Rule ", "Input", "pydantic", "<unicode string>"):
            assert leaked not in finding.message
        assert hint in (finding.hint or "")
        assert finding.option == "rules_file"
        with pytest.raises(FormulaError) as error:
            lab.rule(asked.get("rule"), formula=asked.get("formula"), rules_file=path)
        assert error.value.message == finding.message

    def test_a_parameter_that_is_not_an_option(self, mine):
        path = mine('rules: {push: {formula: "always stands(ego)", parameters: [cut_in_tim, reaction_time]}}')
        finding = told(rule="push", rules_file=path)
        words = "'cut_in_tim' is not an option of traffic rules"
        assert finding.message == f"{path}: rules.push.parameters: {words}"
        assert finding.hint == "did you mean 'cut_in_time'?"

    def test_a_rule_that_was_removed_since(self, mine):
        config = TrafficRuleConfig(rule="push", rules_file=mine())
        path = mine("rules: {pull: {formula: always speed(ego) > 1}}")
        finding = Finding(f"{path} has no rule 'push'", "known: pull", "rule")
        assert check(config, 0.1) == [finding]
