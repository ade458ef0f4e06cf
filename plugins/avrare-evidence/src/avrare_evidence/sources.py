"""Sources of a pack: folders of ``avrare run``, ``avrare check`` and ``avrare rate``."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from avrare.base.errors import UsageError
from avrare.base.stored_files import read_json
from avrare.plugin.options import Options
from avrare.results.run import PROVENANCE, RESULT, Run
from avrare.scenario.fingerprint import fingerprint, named_files
from avrare.scenario.schema import Scenario

SUMMARIES = ("rate.json", "check.json")
"""Files with the verdicts of a catalogue, or of a check."""
_HINT = "give a folder that avrare run, check or rate has written"
_AGAIN = "run it again; relative paths in its options are those of the folder from which it was called"


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
    if (folder / "manifest.json").is_file():
        raise UsageError(f"{folder}: is a pack itself", _HINT)
    results = [path.parent for path in sorted(folder.rglob(RESULT)) if "pilot" not in path.parts]
    if not results:
        raise UsageError(f"{folder}: no result in it", _HINT)
    runs = {f"{path.relative_to(folder).as_posix()}/".removeprefix("./"): _read_run(path) for path in results}
    name = "-".join(dict.fromkeys(run.name for run in runs.values()))
    for file in SUMMARIES:
        if (folder / file).is_file():
            summary = read_json(folder / file, _HINT)
            return Source(str(summary.get("catalogue", name)), folder, runs, file, summary)
    if len(runs) > 1:
        raise UsageError(f"{folder}: holds {len(runs)} runs", f"give one of them: {', '.join(runs)}")
    return Source(name, folder, runs)


def _read_run(folder: Path) -> Run:
    run = Run.read(folder)
    if run.changes:
        raise UsageError("; ".join(run.changes), "evidence is of files as they were written: run it again")
    if run.definition is None:
        raise UsageError(f"{folder}: its scenario cannot be loaded", *run.build_errors[:1])
    if fingerprint(run.definition) != run.fingerprint:
        text = f"{folder}: versions or files that its options name are missing, or have changed since the run"
        raise UsageError(text, _AGAIN)
    return run


def list_run_files(run: Run) -> dict[str, Path]:
    """Return the files of a run that belong into a pack, by name."""
    assert run.folder is not None
    names = (RESULT, PROVENANCE, "failures.npz", *run.files)
    return {name: run.folder / name for name in names if (run.folder / name).is_file()}


def list_files(scenario: Scenario | None) -> dict[str, Path]:
    """Return the files that a scenario's options name, by dotted path."""
    return {
        f"{key}.{option}": path
        for key, config in _list_options(scenario)
        for option, path in named_files(config)
    }


def list_models(scenario: Scenario | None) -> dict[str, Path]:
    """Return the shipped models that a scenario's options name, by dotted path."""
    options = _list_options(scenario)
    return {
        f"{key}.{option}": path for key, config in options for option, path in config.used_models().items()
    }


def _list_options(scenario: Scenario | None, prefix: str = "") -> Iterator[tuple[str, Options]]:
    if scenario is None:
        return
    yield from ((f"{prefix}{key}", block.config) for key, block in scenario.blocks.items())
    yield from _list_options(scenario.cheap, "cheap.")
    for number, member in enumerate(scenario.members):
        yield from _list_options(member, f"ensemble.{number}.")


def redirect(text: str, copies: Mapping[str, str]) -> Iterator[str]:
    """Yield the settings by which a resolved scenario reads copies of the files that its options name.

    Files that merely lie beside a named one have no option, and need none.
    """
    tree = yaml.safe_load(text)
    for option, copy in copies.items():
        value = tree
        for name in option.split("."):
            value = value.get(name) if isinstance(value, dict) else None
        if isinstance(value, str) and Path(value).name == Path(copy).name:
            yield f"{option}={json.dumps(copy, ensure_ascii=False)}"


def list_laws(scenario: Scenario) -> dict[str, Any]:
    """Return the laws of the drawn options by name, as in the scenario file."""
    draws = scenario.simulator.draws
    pairs = zip(draws.names, draws.laws, strict=True) if draws is not None else ()
    return {name: json.loads(law.model_dump_json(exclude_none=True)) for name, law in pairs}
