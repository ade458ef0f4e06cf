"""Packs: written from results, and checked file by file."""

from __future__ import annotations

import hashlib
import math
import os
import shlex
import shutil
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from importlib.metadata import distributions
from pathlib import Path
from typing import Any, Literal

import yaml
from jinja2 import Environment, PackageLoader, StrictUndefined
from pydantic import BaseModel, ConfigDict, Field
from pydantic_core import to_jsonable_python

from avrare.analysis.rates.combination import from_exposure
from avrare.base import number_format
from avrare.base.atomic_files import explain_file_errors, write_text
from avrare.base.errors import UsageError
from avrare.base.stored_files import digest, read_model
from avrare.estimation.loop.checkpoint import SCENARIO
from avrare.estimation.result.result import finite
from avrare.results.run import PROVENANCE, RESULT
from avrare.results.stored_results import FAILURES_FILE
from avrare.scenario.fingerprint import list_options, named_files
from avrare.scenario.schema import Scenario
from avrare.scenario.yaml import dump
from avrare_evidence.argument import CASES, STATES, Case, build_case, find_faults, find_kind
from avrare_evidence.sources import CHECK, MANIFEST, Source, list_claims, read_sources

CASE, PAGE, SHEET, CONFIRMATION = "case.gsn.yaml", "case.md", "test_case.yaml", "confirmation.yaml"
_HINT = "give the folder that `avrare evidence --out` has written, or write it again"
_CHECK_OPTIONS = ("--looks", "--save", "--accept-changes")
"""Options of a check that its numbers depend on, and that stand in no scenario."""
Sheet = dict[str, Any]
"""Content of a test-case sheet."""
_GRAPH_CHARACTERS, _TABLE_CHARACTERS = 110, 440
"""Characters of a text, after which the graph and the tables cut it; ``case.gsn.yaml`` has the whole."""


class Manifest(BaseModel):
    """Content of manifest.json: versions, copies of the files that a run's options name, and SHA-256."""

    model_config = ConfigDict(strict=True, frozen=True, extra="forbid")

    schema_: Literal[1] = Field(alias="schema")
    versions: dict[str, str]
    runs: dict[str, dict[str, str]] = Field(min_length=1)
    files: dict[str, str]


@dataclass(frozen=True)
class Pack:
    """Pack in a folder: its argument and its manifest."""

    folder: Path
    case: Case
    manifest: Manifest

    @staticmethod
    def read(folder: str | os.PathLike[str]) -> Pack:
        """Read a pack, whose files may have changed since.

        Raises:
            UsageError: Its manifest or case is missing or cannot be read.
        """
        path = Path(folder)
        if path.is_dir() and not (path / MANIFEST).exists():
            text = f"{path}: no {MANIFEST} in it: it is not a pack, or its writing was interrupted"
            raise UsageError(text, _HINT)
        manifest = read_model(Manifest, path / MANIFEST, _HINT)
        try:
            content = yaml.safe_load((path / CASE).read_text(encoding="utf-8"))
            elements = {key: content[key] for key in content if key != "module"}
            return Pack(path, CASES.validate_python(elements), manifest)
        except (OSError, TypeError, ValueError, yaml.YAMLError) as error:
            raise UsageError(f"{path / CASE}: cannot be read: {error}", _HINT) from None

    def find_faults(self) -> list[str]:
        """Return a line for each file that changed, is missing or was added, and on its argument's faults."""
        files, present = self.manifest.files, hash_files(self.folder)
        changes = {"": "is missing", "link": "is a link"}
        altered = [name for name in files if files[name] != present.get(name)]
        faults = [f"{name}: {changes.get(present.get(name, ''), 'was changed')}" for name in altered]
        added = present.keys() - {*files, MANIFEST, CONFIRMATION}
        faults += [f"{name}: is not in the manifest" for name in sorted(added)]
        needed = [(f"{CASE}: {key}", element.url.partition("#")[0]) for key, element in self.case.items()]
        for run, copies in self.manifest.runs.items():
            names = (f"evidence/{run}/{SCENARIO}", f"evidence/{run}/{RESULT}", name_scenario(run))
            needed += [(f"{MANIFEST}: {run}", name) for name in (*names, *copies.values())]
        lost = [(place, name) for place, name in needed if name and name not in files]
        faults += [f"{place} refers to {name}, which has no digest" for place, name in lost]
        return faults + [f"{CASE}: {fault}" for fault in find_faults(self.case)]

    def find_version_changes(self) -> list[str]:
        """Return a line for each distribution whose installed version is not that of the pack."""
        installed = {distribution.name: distribution.version for distribution in distributions()}
        return [
            f"{name}: {text} in the pack, {here} here: its results are older or newer than the code"
            for name, text in self.manifest.versions.items()
            if (here := installed.get(name, "not installed")) != text
        ]

    def find_other_files(self, run: str, scenario: Scenario) -> list[str]:
        """Return a line for each option of the scenario of a run that names another file than the pack's."""
        paths = {option: path for files in list_files(scenario) for option, path in files.items()}
        return [
            f"{option}: the file {Path(copy).name} is missing here, or not that of the pack"
            for option, copy in self.manifest.runs[run].items()
            if option not in paths or hash_file(paths[option]) != self.manifest.files[copy]
        ]


def write_pack(folders: Sequence[str | os.PathLike[str]], out: str | os.PathLike[str]) -> Pack:
    """Write a pack of results; the same results give the same bytes.

    Args:
        folders: Folders of ``avrare run``, ``check`` and ``rate``.
        out: Folder of the pack, which is new or empty.

    Raises:
        UsageError: A folder has no result, has changed since, or the pack cannot be written.
    """
    sources, folder = read_sources([Path(path) for path in folders]), Path(out)
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise UsageError(f"{folder}: is not an empty folder", "choose another --out")
    with explain_file_errors(f"{folder}: cannot write the pack", "choose another --out"):
        copies, sheets, versions = dict[str, dict[str, str]](), dict[str, Sheet](), dict[str, str]()
        for source in sources:
            copy_file(source.folder / source.file, folder, f"evidence/{source.name}/{source.file}")
            for name, run in source.runs.items():
                copies[name] = _copy_run(source, name, folder)
                measures = [claim.measure for claim in list_claims(source) if name in claim.results]
                sheet = fill_template(SHEET, name=name, run=run, files=copies[name], measures=measures)
                sheets[f"test-cases/{name}.yaml"] = yaml.safe_load(sheet)
                versions |= run.versions
        title, case = ", ".join(source.name for source in sources), build_case(sources, hash_files(folder))
        module = {"name": title, "brief": "Argument from simulated drives", "extra": versions}
        elements = CASES.dump_python(case, by_alias=True, exclude_defaults=True)
        pages = {path: dump_yaml(content) for path, content in sheets.items()}
        pages[CASE] = dump_yaml({"module": module, **elements})
        commands = [command for source in sources for command in list_commands(source)]
        pages[PAGE] = fill_template(PAGE, name=title, case=case, sheets=sheets, commands=commands)
        for path, page in pages.items():
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            write_text(folder / path, page)
        manifest = Manifest(schema=1, versions=versions, runs=copies, files=hash_files(folder))
        write_text(folder / MANIFEST, manifest.model_dump_json(indent=2, by_alias=True) + "\n")
    return Pack(folder, case, manifest)


def _copy_run(source: Source, name: str, folder: Path) -> dict[str, str]:
    """Copy a run with the scenario that repeats it, and return the copies of its files by option."""
    run, copies, redirected = source.runs[name], dict[str, str](), dict[Path, str]()
    assert run.folder is not None
    assert run.definition is not None
    for file in (RESULT, PROVENANCE, FAILURES_FILE, *run.files):
        copy_file(run.folder / file, folder, f"evidence/{name}/{file}")
    if (baseline := source.summary.baselines.get(run.name)) is not None:
        copy_file(baseline, folder, f"repeat/baseline/{name}/{baseline.name}")
    for files in list_files(run.definition):
        base = os.path.commonpath([path.absolute().parent for path in files.values()])
        places = {path: Path(os.path.relpath(path, base)).as_posix() for path in files.values()}
        home = f"files/{digest(repr([(place, hash_file(path)) for path, place in places.items()]))[:8]}"
        for option, path in files.items():
            copy = f"{home}/{places[path]}"
            copies[option] = copy_file(path, folder, f"repeat/{copy}")
            if not os.access(path, os.X_OK):  # a program runs where it is installed
                redirected[path] = copy
    (folder / "repeat").mkdir(exist_ok=True)
    write_text(folder / name_scenario(name), dump(_redirect(run.definition.resolved, redirected)))
    return copies


def name_scenario(run: str) -> str:
    """Return the file of the pack that repeats a run."""
    return f"repeat/{run.replace('/', '+')}.yaml"


def list_files(scenario: Scenario) -> list[dict[str, Path]]:
    """Return the files and shipped models that options name, by dotted path, for each component with any."""
    components = [
        {f"{key}.{option}": path for option, path in [*named_files(config), *config.used_models().items()]}
        for key, config in list_options(scenario)
    ]
    return [files for files in components if files]


def _redirect(value: Any, copies: Mapping[Path, str]) -> Any:
    if isinstance(value, Mapping):
        return {key: _redirect(entry, copies) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_redirect(entry, copies) for entry in value]
    return copies.get(Path(value), value) if isinstance(value, str) else value


def copy_file(path: Path, folder: Path, copy: str) -> str:
    """Copy a file and its card, if it has one, to their place in the pack, and return that of the file."""
    for suffix in {path.suffix, ".md"}:
        if (origin := path.with_suffix(suffix)).is_file():
            target = (folder / copy).with_suffix(suffix)
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(origin, target)
    return copy


def list_commands(source: Source) -> Iterator[str]:
    """Yield the commands that give the numbers of a source again, called in a copy of ``repeat``."""
    command = "check" if source.file == CHECK else "run"
    groups = {name: [name] for name in source.runs} if command == "run" else {source.name: [*source.runs]}
    for out, names in groups.items():
        origin = source.runs[names[0]].provenance
        words = [name_scenario(name).removeprefix("repeat/") for name in names]
        words += [word for word in origin.command if word in _CHECK_OPTIONS]
        words += ["--budget", origin.budget] if origin.budget else []
        if any(row.kind == "regression" for row in source.summary.rows):
            words += ["--baseline", f"baseline/{source.name}"]
        yield shlex.join(["avrare", command, *words, "--out", f"runs/{out}"])


def fill_template(template: str, **values: object) -> str:
    """Return a page of a pack, for the file of which there is a template."""
    environment = Environment(trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True)
    environment.undefined, environment.loader = StrictUndefined, PackageLoader("avrare_evidence", "")
    environment.filters |= vars(number_format) | {"kind": find_kind, "finite": finite, "group": _group}
    environment.filters |= {"yaml": _dump_in_line, "describe": _describe, "mermaid": _escape}
    environment.filters |= {"table": _tabulate, "exposure": from_exposure}
    return environment.get_template(f"{template}.jinja").render(states=STATES, **values)


def dump_yaml(content: object, **style: Any) -> str:
    """Return plain data as YAML in its order, in this style."""
    return str(yaml.safe_dump(content, sort_keys=False, allow_unicode=True, **{"width": 110, **style}))


def _dump_in_line(value: object) -> str:
    plain = to_jsonable_python(value, exclude_none=True)
    return dump_yaml([plain], default_flow_style=True, width=math.inf).strip()[1:-1]


def _group(sheets: Mapping[str, Sheet], path: str) -> list[tuple[str, ...]]:
    """List the entries of a part of each sheet, each once with the test cases that it is common to."""
    cases: dict[tuple[str, ...], list[str]] = {}
    for file, sheet in sheets.items():
        content = reduce(lambda part, key: part[key], path.split("."), sheet)
        for entry in content:
            row = (entry, _describe(content[entry])) if isinstance(content, dict) else (entry,)
            cases.setdefault(row, []).append(file[len("test-cases/") : -len(".yaml")])
    return [(*row, "all" if len(names) == len(sheets) else ", ".join(names)) for row, names in cases.items()]


def _tabulate(rows: Sequence[Sequence[str]], head: str) -> str:
    lines = [head, " | ".join("---" for _ in head.split(" | "))]
    lines += [" | ".join(cell.replace("|", "\\|") for cell in row) for row in rows]
    return "\n".join(f"| {line} |" for line in lines) if rows else "None."


def _describe(value: object) -> str:
    text = value if isinstance(value, str) else _dump_in_line(value)
    return f"`{textwrap.shorten(text, _TABLE_CHARACTERS, placeholder=' ...')}`"


def _escape(text: str) -> str:
    """Return a short form of a text that Mermaid shows as it is."""
    short = textwrap.shorten(text, _GRAPH_CHARACTERS, placeholder=" ...")
    return "".join(f"#{ord(character)};" if character in '"<>`#;&' else character for character in short)


def hash_files(folder: Path) -> dict[str, str]:
    """Return the SHA-256 of all files below a folder, by path."""
    paths = sorted(path for path in folder.rglob("*") if path.is_symlink() or path.is_file())
    return {path.relative_to(folder).as_posix(): hash_file(path) for path in paths}


def hash_file(path: Path) -> str:
    """Return the SHA-256 of a file; "link" for a link, "" for none."""
    if path.is_symlink():
        return "link"
    return hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else ""
