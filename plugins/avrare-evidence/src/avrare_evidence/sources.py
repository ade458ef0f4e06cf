"""Sources of a pack: folders of ``avrare run``, ``avrare check`` and ``avrare rate``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from avrare.base.errors import UsageError
from avrare.base.stored_files import read_json
from avrare.results.run import PROVENANCE, RESULT, Run
from avrare.scenario.fingerprint import named_files
from avrare.scenario.schema import Scenario

_SUMMARIES = {"rate": ("rate.json", "catalogue"), "check": ("check.json", "")}
"""Kind -> file with the verdicts, and its key with a name."""
_HINT = "give a folder that avrare run, check or rate has written"


@dataclass(frozen=True)
class Source:
    """Folder with results.

    Attributes:
        name: Name of the scenario or catalogue; unique in a pack.
        folder: The folder.
        runs: Its runs, by their place in the folder with a slash behind it: "" or "scenes/wet/".
        file: File with the verdicts.
        summary: Content of check.json or rate.json; empty for a run.
    """

    name: str
    folder: Path
    runs: dict[str, Run]
    file: str = RESULT
    summary: dict[str, Any] = field(default_factory=dict)

    @property
    def home(self) -> str:
        """Folder of the source in the pack."""
        return f"evidence/{self.name}/"


def read_sources(folders: Sequence[Path]) -> list[Source]:
    """Read the folders.

    Raises:
        UsageError: One has no finished result, its files have changed since, or two have the same name.
    """
    sources = [_read_source(folder) for folder in folders]
    names = [source.name for source in sources]
    for name in names:
        if names.count(name) > 1:
            raise UsageError(f"two of the results are named {name!r}", "give each scenario a name of its own")
    return sources


def _read_source(folder: Path) -> Source:
    results = [path.parent for path in sorted(folder.rglob(RESULT)) if "pilot" not in path.parts]
    if not results:
        raise UsageError(f"{folder}: no result in it", _HINT)
    runs = {f"{path.relative_to(folder).as_posix()}/".removeprefix("./"): _read_run(path) for path in results}
    name = "-".join(dict.fromkeys(run.name for run in runs.values()))
    for file, key in _SUMMARIES.values():
        if (folder / file).is_file():
            summary = read_json(folder / file, _HINT)
            return Source(str(summary.get(key, name)), folder, runs, file, summary)
    if len(runs) > 1:
        raise UsageError(f"{folder}: holds {len(runs)} runs", f"give one of them: {', '.join(runs)}")
    return Source(name, folder, runs)


def _read_run(folder: Path) -> Run:
    run = Run.read(folder)
    if run.changes:
        raise UsageError("; ".join(run.changes), "evidence is of files as they were written: run it again")
    if run.definition is None:
        raise UsageError(f"{folder}: its scenario cannot be loaded", *run.build_errors[:1])
    return run


def list_run_files(run: Run) -> dict[str, Path]:
    """Return the files of a run that belong into a pack, by name."""
    assert run.folder is not None
    names = (RESULT, PROVENANCE, "failures.npz", *run.files)
    return {name: run.folder / name for name in names if (run.folder / name).is_file()}


def list_named_files(scenario: Scenario) -> dict[str, list[Path]]:
    """Return the files that a scenario's options name, with their cards (``NAME.md``), by option.

    Shipped models stand under ``OPTION (model)``.
    """
    files: dict[str, Path] = {}
    for key, block in scenario.blocks.items():
        files |= {f"{key}.{option}": path for option, path in named_files(block.config)}
        files |= {f"{key}.{option} (model)": path for option, path in block.config.used_models().items()}
    cards = {option: path.with_suffix(".md") for option, path in files.items()}
    return {option: [path, *([cards[option]] * cards[option].is_file())] for option, path in files.items()}


def list_laws(scenario: Scenario) -> dict[str, Any]:
    """Return the laws of the drawn options by name, as in the scenario file."""
    draws = scenario.simulator.draws
    pairs = zip(draws.names, draws.laws, strict=True) if draws is not None else ()
    return {name: json.loads(law.model_dump_json(exclude_none=True)) for name, law in pairs}
