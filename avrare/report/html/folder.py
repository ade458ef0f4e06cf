"""What a run has left in its folder, read for a report."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from avrare.build.scenario import BuildableScenario
from avrare.errors import AvrareError
from avrare.estimation.result import Failures
from avrare.record.failures import read_failures
from avrare.record.rollouts import Sample, read_rollouts
from avrare.record.written import read_json, read_result, written_at
from avrare.scenario.load import load
from avrare.scenario.schema import Scenario, Threshold


@dataclass(frozen=True)
class RunFolder:
    """A run's folder.

    Attributes:
        path: Of the folder.
        result: Content of result.json.
        provenance: Content of provenance.json, empty where it is missing.
        written: When the result was written.
        text: The resolved scenario as YAML.
        definition: The scenario, loaded anew; None where that cannot be.
        scenario: With its parts built; None where that cannot be.
        trouble: Why not, in the words that the command line would use.
        failures: Specification -> stored failures.
        samples: Specification -> robustness of the rollouts and the worst of them.
    """

    path: Path
    result: dict[str, Any]
    provenance: dict[str, Any]
    written: datetime
    text: str
    definition: Scenario | None
    scenario: BuildableScenario | None
    trouble: tuple[str, ...]
    failures: dict[str, Failures]
    samples: dict[str, Sample]

    @property
    def name(self) -> str:
        """Of the scenario."""
        return str(self.result["scenario"])

    @property
    def estimates(self) -> list[dict[str, Any]]:
        """The entries of result.json."""
        return list(self.result["estimates"])

    def thresholds(self, specification: str) -> list[Threshold]:
        """Those that the scenario sets for a specification."""
        known = () if self.definition is None else self.definition.thresholds
        return [one for one in known if one.specification == specification]


def read_folder(path: Path) -> RunFolder:
    """Read a run's folder; a scenario that cannot be loaded any more is no error.

    Raises:
        UsageError: It is no run's folder, or its files are damaged.
    """
    result = read_result(path)
    text = _text(path / "scenario.yaml")
    definition, scenario, trouble = _scenario(path / "scenario.yaml")
    provenance = read_json(path / "provenance.json") if (path / "provenance.json").is_file() else {}
    return RunFolder(
        path, result, provenance, written_at(path), text, definition, scenario, trouble,
        read_failures(path), read_rollouts(path),
    )  # fmt: skip


def _scenario(path: Path) -> tuple[Scenario | None, BuildableScenario | None, tuple[str, ...]]:
    """The scenario, checked, and built; or why that cannot be."""
    definition = None
    try:
        definition = load(path)
        scenario = BuildableScenario(definition)
        _ = scenario.stack
    except AvrareError as error:
        return definition, None, tuple(error.lines())
    return definition, scenario, ()


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        return ""
