"""Several scenario files of one command, and catalogues among them."""

from __future__ import annotations

import os
from collections.abc import Sequence

from avrare.base.errors import AvrareError, ScenarioError, UsageError, require_path
from avrare.base.stored_files import open_regular
from avrare.scenario.load import load
from avrare.scenario.schema import Scenario
from avrare.scenario.yaml import MAX_BYTES, parse


def load_scenarios(
    paths: Sequence[str | os.PathLike[str]], overrides: Sequence[str] = (), estimator: str | None = None
) -> list[Scenario]:
    """Load scenario files, which must have different names.

    Raises:
        ScenarioError: A file has mistakes.
        UsageError: A file is a catalogue, or two scenarios have the same name.
    """
    try:
        scenarios = [load(path, overrides, estimator) for path in paths]
    except ScenarioError:
        for path in (path for path in paths if is_catalogue(path)):
            text = f"{path}: is a catalogue of scenes, and no scenario"
            raise UsageError(text, f"avrare rate {path}, or with thresholds avrare check {path}") from None
        raise
    names = sorted(scenario.name for scenario in scenarios)
    if len(set(names)) < len(names):
        raise UsageError(f"two scenarios have the same name: {', '.join(names)}", "give one per command")
    return scenarios


def is_catalogue(path: str | os.PathLike[str]) -> bool:
    """Return whether a file is a list of scenes; one that cannot be read is none."""
    name = require_path(path, "a scenario file")
    try:
        with open_regular(name) as file:
            top = parse(file.read(MAX_BYTES), name)
    except (AvrareError, OSError, ValueError):
        return False
    return top.child("scenes") is not None and top.child("simulator") is None
