"""Commands and functions that other distributions provide, loaded when they are first used."""

from __future__ import annotations

from importlib.metadata import entry_points  # half the time of `avrare --help`, so not imported there
from typing import Any

from avrare.base.errors import PluginError

COMMAND_GROUP = "avrare.commands"
FUNCTION_GROUP = "avrare.functions"
FUNCTIONS = {
    "confirm": "avrare-evidence",
    "evidence": "avrare-evidence",
    "export": "avrare-recordings",
    "monitor": "avrare-recordings",
    "monitor_all": "avrare-recordings",
    "require": "avrare-design",
    "sensitivity": "avrare-design",
    "synthesise": "avrare-design",
}
"""Name of a function of ``avrare`` -> the distribution that provides it."""


def list_functions() -> list[str]:
    """Return the names of the functions that installed distributions add to ``avrare``."""
    return sorted({point.name for point in entry_points(group=FUNCTION_GROUP)})


def load_function(name: str) -> Any:
    """Return a function that an installed distribution adds to ``avrare``.

    Raises:
        PluginError: Its distribution is not installed.
        AttributeError: No distribution provides a function of this name.
    """
    if name not in FUNCTIONS and name not in list_functions():
        raise AttributeError(f"module 'avrare' has no attribute {name!r}")
    return _load_first(FUNCTION_GROUP, name, f"avrare.{name}", FUNCTIONS.get(name, ""))


def load_command(name: str, distribution: str) -> Any:
    """Return the module of a command.

    Raises:
        PluginError: Its distribution is not installed.
    """
    return _load_first(COMMAND_GROUP, name, f"avrare {name}", distribution)


def _load_first(group: str, name: str, title: str, distribution: str) -> Any:
    for point in entry_points(group=group, name=name):
        return point.load()
    raise PluginError(
        f"{title} is provided by {distribution}, which is not installed", f"pip install {distribution}"
    )
