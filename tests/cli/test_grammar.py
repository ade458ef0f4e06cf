"""One grammar: an option of a name is written, explained and preset alike in every command."""

import argparse

import pytest

from avrare.cli.main import COMMANDS, GROUPS, PROVIDED, command_parser
from avrare.plugin.provided import COMMAND_GROUP, entry_points

INSTALLED = {point.name for point in entry_points(group=COMMAND_GROUP)}
FITS = {"pem", "flow"}
"""Commands without a scenario, whose seed is 0."""


def list_options(parser):
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for inner in action.choices.values():
                yield from list_options(inner)
        elif action.option_strings:
            yield action.option_strings[0], action


OPTIONS = [
    (command, name, action)
    for command in [*COMMANDS, *(name for name in PROVIDED if name in INSTALLED)]
    for name, action in list_options(command_parser(command))
]


def test_every_command_stands_under_one_heading():
    names = [name for group in GROUPS.values() for name in group]
    assert sorted(names) == sorted([*COMMANDS, *PROVIDED])


@pytest.mark.parametrize(
    ("option", "metavar", "default"),
    [("--budget", "KIND=N", ...), ("--out", "DIR", ...), ("--workers", "N", 1), ("--seed", "N", None)],
)
def test_an_option_takes_the_same_everywhere(option, metavar, default):
    takers = {command: action for command, name, action in OPTIONS if name == option}
    assert len(takers) > 5
    assert {action.metavar for action in takers.values()} == {metavar}
    presets = {action.default for command, action in takers.items() if command not in FITS}
    assert default is ... or presets == {default}


@pytest.mark.parametrize("option", ["--json", "--quiet", "--plain", "--resume", "--safe", "--workers"])
def test_an_option_is_explained_alike_everywhere(option):
    lists = {"plugins", "rules", "scenes", "pem"}  # their JSON is a list, and they print nothing else
    helps = {
        action.help
        for command, name, action in OPTIONS
        if name == option and not (command in lists and option == "--json")
        if not (command == "check" and option == "--resume")  # it saves only then
    }
    assert len(helps) == 1


@pytest.mark.parametrize(
    "command", ["run", "check", "rate", "compare", "why", "replay", "falsify", "monitor"]
)
def test_a_command_that_answers_prints_json_or_little(command):
    if command in PROVIDED and command not in INSTALLED:
        pytest.fail(f"{PROVIDED[command][0]} is not installed")
    assert {"--json", "--quiet", "--plain"} <= {name for owner, name, _ in OPTIONS if owner == command}
