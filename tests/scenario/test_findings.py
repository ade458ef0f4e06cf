"""Findings of components' own checks, told at the place of the option."""

import pytest

from avrare.plugin import Finding
from avrare.plugin.component import Component

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
