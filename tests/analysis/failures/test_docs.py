"""docs/failures.md: its code runs, its commands exist."""

import re
import shlex
from pathlib import Path

import pytest

from avrare.cli.main import command_parser

PAGE = (Path(__file__).parents[3] / "docs" / "failures.md").read_text()
LINES = re.findall(r"^\$ avrare (.+)$", PAGE, re.MULTILINE)


@pytest.mark.slow
def test_the_code_runs_and_comes_near_the_nearest_failure(capsys):
    [code] = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    names: dict = {}
    exec(compile(code, "docs/failures.md", "exec"), names)
    assert min(one.norm for one in names["found"]) < 2.83 * 1.05
    assert capsys.readouterr().out


@pytest.mark.parametrize("line", LINES)
def test_the_commands_are_understood(line):
    name, *words = shlex.split(line)
    assert vars(command_parser(name).parse_args(words))


def test_there_are_commands():
    assert {line.split()[0] for line in LINES} == {"run", "replay", "falsify"}
