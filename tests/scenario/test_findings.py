"""What is told of a scenario before anything runs: findings of components, formulas and times."""

import pytest

from avrare.logic.syntax.nodes import bounded_span
from avrare.logic.syntax.parser import parse
from avrare.plugin import Finding
from avrare.plugin.component import Component
from avrare.scenario.specification_checks import reach_warnings

WRITTEN = "near: {plugin: book, rule: R_G1}"


@pytest.fixture
def says(monkeypatch):
    """Let every specification's check return findings; gives the arguments that it was called with."""

    def says(*findings):
        calls = []

        def check(part, config, dt):
            calls.append((config.rule, dt))
            return [finding for finding in findings if config.rule == "R_G1"]

        monkeypatch.setattr(Component, "find_faults", check)
        return calls

    return says


def test_errors_are_placed_at_the_option_or_at_the_block(says, fails, good):
    calls = says(
        Finding("there is no such thing\n  a b\n    ^", "write c", "rule"),
        Finding("too slow", None, "speed"),
        Finding("two things at once"),
        Finding("odd", is_error=False),
    )
    assert WRITTEN in good
    lines, code = fails(good)
    assert code == 4
    assert lines == [
        "s.yaml:9:3: specifications.near: two things at once",
        "s.yaml:9:3: specifications.near.speed: too slow",
        "s.yaml:9:30: specifications.near.rule: there is no such thing\n  a b\n    ^",
        "hint: write c",
    ]
    assert calls == [("R_G1", 0.1), ("R_G2", 0.1)]


def test_a_finding_that_is_not_an_error_is_a_warning(says, read, good):
    says(Finding("odd", "write c", "rule", is_error=False))
    assert read(good).warnings == (("s.yaml:9:30: specifications.near.rule: odd", "write c"),)
    overridden = read(good, ["specifications.far.rule=R_G1"]).warnings
    assert overridden[-1] == ("--set specifications.far.rule: odd", "write c")


def test_a_check_that_fails_is_the_plugins_fault(monkeypatch, fails, good):
    def broken(part, config, dt):
        raise RuntimeError("no\nidea")

    monkeypatch.setattr(Component, "find_faults", broken)
    lines, code = fails(good)
    assert code == 5
    assert lines[0] == "s.yaml:9:3: specifications.near: the plugin's own check failed: RuntimeError: no idea"


FAR = "{plugin: book, rule: R_G2}"


def test_an_error_shows_the_place_in_the_file_and_in_the_formula(good, fails):
    lines, code = fails(good.replace(FAR, '{stl: "always (gap > )"}'))
    assert code == 4
    first, formula, caret = lines[0].split("\n")
    assert first.startswith("s.yaml:10:14: specifications.far.stl: line 1, column 15: ")
    assert formula == "  always (gap > )"
    assert caret.index("^") == formula.index(")")


def test_bounds_are_checked_against_the_simulators_step(good, fails, read):
    text = good.replace(FAR, '{stl: "always[0:0.25s] (gap > 2)"}')
    assert "not a whole multiple of dt = 0.1 s" in fails(text)[0][0]
    assert read(text.replace("dt: 0.1", "dt: 0.05")).warnings == ()


def test_a_bound_beyond_the_rollout_is_a_warning(good, read):
    text = good.replace(FAR, '{stl: "eventually[0:6s] (gap > 2)"}')
    [(message, hint)] = read(text).warnings
    assert hint is None
    assert message == (
        "s.yaml:10:14: specifications.far.stl: the formula looks 60 samples ahead but a rollout ends "
        "after 40: windows are clipped at its last sample"
    )


@pytest.mark.parametrize(
    ("text", "span"),
    [
        ("always[0:4] p", 4),
        ("always eventually p", 0),
        ("always (p -> eventually[0:10] (q and next next p))", 12),
        ("always (p -> (q until[2:6] p) or always[0:3] eventually[1:5] q)", 8),
        ("eventually[7:inf] p", 7),
        ("always (p -> once[0:50] q)", 0),
        ("forall o in others: always (p -> next q)", 1),
    ],
)
def test_only_bounded_future_operators_count(text, span):
    node = parse(text)
    assert bounded_span(node) == span
    assert reach_warnings(node, span) == []
    for steps in range(span):
        [words] = reach_warnings(node, steps)
        assert words.startswith(f"the formula looks {span} samples ahead but a rollout ends after {steps}: ")


def test_warnings_of_the_formula_language_are_passed_on(good, read):
    text = good.replace(FAR, '{stl: "always gap > 2 and speed > 0"}')
    [(message, hint)] = read(text).warnings
    assert message.startswith("s.yaml:10:14: specifications.far.stl: line 1, column 1: ")
    assert "always (... and ...)" in hint
    assert read(good.replace(FAR, '{stl: "(always gap > 2) and speed > 0"}')).warnings == ()


TIMED = "timing:\n  planner_period: {planner}\n  perception_latency: {latency}\n"


@pytest.fixture
def timed(good):
    """Return the text of a scenario of 4 s with these times in its last lines."""

    def write(planner=0.2, latency=0.1):
        return good + TIMED.format(planner=planner, latency=latency)

    return write


def test_a_period_between_steps_is_an_error_at_its_place(fails, timed):
    line = timed().splitlines().index("timing:") + 2
    lines, code = fails(timed(planner=0.25))
    assert code == 4
    assert lines == [
        f"s.yaml:{line}:19: timing.planner_period: 0.25 s is not a multiple of the simulator's step, 0.1 s",
        "hint: such as 0.2",
    ]


def test_periods_that_do_not_fit_each_other_are_an_error(fails, good):
    lines, _ = fails(f"{good}timing: {{sensor_period: 0.2, tracker_period: 0.3}}\n")
    assert "timing.tracker_period: 0.3 s is not a multiple of sensor_period, 0.2 s" in lines[0]


@pytest.mark.parametrize(
    ("times", "text"),
    [
        ({"planner": 4.0}, "planner_period: 4 s is not shorter than the drive, 4 s: it has a single plan"),
        ({"latency": 5}, "perception_latency: 5 s is not shorter than the drive, 4 s: none of its frames"),
    ],
)
def test_a_time_as_long_as_the_drive_is_a_warning(read, timed, times, text):
    [(message, hint)] = read(timed(**times)).warnings
    assert text in message
    assert message.startswith("s.yaml:")
    assert hint is None


def test_times_within_the_drive_are_not_warned_of(read, timed):
    assert read(timed(planner=3.9, latency=3.95)).warnings == ()
