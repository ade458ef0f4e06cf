"""Packs: written from results, and checked file by file."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import distributions
from pathlib import Path
from typing import Any, Literal

import yaml
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter

from avrare.base.atomic_files import explain_file_errors, write_text
from avrare.base.errors import UsageError
from avrare.base.stored_files import read_model
from avrare.estimation.loop.checkpoint import SCENARIO
from avrare.estimation.result.result import finite
from avrare.results.run import PROVENANCE, RESULT, Run
from avrare.scenario.fingerprint import list_options, named_files
from avrare.scenario.schema import Block, Scenario
from avrare.scenario.yaml import dump
from avrare_evidence.argument import Claim, Sheet, build_case, list_claims
from avrare_evidence.gsn import Case, find_faults
from avrare_evidence.page import write_page
from avrare_evidence.sources import MANIFEST, read_sources

CASE, PAGE, CONFIRMATION = "case.gsn.yaml", "case.md", "confirmation.yaml"
_HINT = "give the folder that `avrare evidence --out` has written, or write it again"


class PackedRun(BaseModel):
    """Run in a pack: ``scenario`` repeats it, ``files`` has the copies of what options name, by option."""

    model_config = ConfigDict(strict=True, frozen=True, extra="forbid")

    name: str
    folder: str
    scenario: str
    fingerprint: str
    seed: int
    budget: str | None
    versions: dict[str, str]
    files: dict[str, str]


class Manifest(BaseModel):
    """Content of manifest.json."""

    model_config = ConfigDict(strict=True, frozen=True, extra="forbid")

    schema_: Literal[1] = Field(alias="schema")
    runs: list[PackedRun] = Field(min_length=1)
    files: dict[str, str]


@dataclass(frozen=True)
class Pack:
    """Pack in a folder: its argument and its manifest."""

    folder: Path
    case: Case
    manifest: Manifest


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
        runs, sheets = list[PackedRun](), dict[str, Sheet]()
        for source in sources:
            claims = list_claims(source)
            _copy(source.folder / source.file, folder, source.home + source.file)
            for place, run in source.runs.items():
                runs.append(_copy_run(f"{source.name}/{place}".rstrip("/"), run, folder))
                sheets[f"test-cases/{runs[-1].name}.yaml"] = _describe_test_case(run, runs[-1], claims)
        case = build_case(sources, sheets, hash_files(folder))
        versions = {name: text for run in runs for name, text in sorted(run.versions.items())}
        name = ", ".join(source.name for source in sources)
        module = {"name": name, "brief": "Argument from simulated drives", "extra": versions}
        elements = {
            key: element.model_dump(by_alias=True, exclude_defaults=True) for key, element in case.items()
        }
        for path, content in {**sheets, CASE: {"module": module, **elements}}.items():
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            write_text(folder / path, dump_yaml(content))
        write_text(folder / PAGE, write_page(name, case, sheets))
        manifest = Manifest(schema=1, runs=runs, files=hash_files(folder))
        write_text(folder / MANIFEST, manifest.model_dump_json(indent=2, by_alias=True) + "\n")
    return Pack(folder, case, manifest)


def _copy_run(name: str, run: Run, folder: Path) -> PackedRun:
    """Copy the files of a run and those that it names, and write the scenario that names the copies."""
    assert run.folder is not None
    assert run.definition is not None
    for file in (RESULT, PROVENANCE, "failures.npz", *run.files):
        if (run.folder / file).is_file():
            _copy(run.folder / file, folder, f"evidence/{name}/{file}")
    copies, redirected = {}, {}
    for files in list_files(run.definition):
        base = os.path.commonpath([path.absolute().parent for path in files.values()])
        places = {path: Path(os.path.relpath(path, base)).as_posix() for path in files.values()}
        content = repr([(place, hash_file(path)) for path, place in places.items()])
        for option, path in files.items():
            copy = f"files/{hashlib.sha256(content.encode()).hexdigest()[:8]}/{places[path]}"
            copies[option] = _copy(path, folder, f"repeat/{copy}")
            if not os.access(path, os.X_OK):  # a program runs where it is installed
                redirected[path] = copy
    scenario = f"repeat/{name.replace('/', '+')}.yaml"
    (folder / scenario).parent.mkdir(exist_ok=True)
    write_text(folder / scenario, dump(_redirect(run.definition.resolved, redirected)))
    return PackedRun(
        name=name,
        folder=f"evidence/{name}/",
        scenario=scenario,
        fingerprint=run.fingerprint,
        seed=run.seed,
        budget=run.provenance.budget,
        versions=dict(run.versions),
        files=copies,
    )


def list_files(scenario: Scenario) -> list[dict[str, Path]]:
    """Return the files and shipped models that options name, by dotted path, for each component with any."""
    components = [
        {f"{key}.{option}": path for option, path in [*named_files(config), *config.used_models().items()]}
        for key, config in list_options(scenario)
    ]
    return [files for files in components if files]


def _copy(path: Path, folder: Path, copy: str) -> str:
    """Copy a file and its card, if it has one, to their place in the pack."""
    for suffix in {path.suffix, ".md"}:
        if (origin := path.with_suffix(suffix)).is_file():
            target = (folder / copy).with_suffix(suffix)
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(origin, target)
    return copy


def _redirect(value: Any, copies: Mapping[Path, str]) -> Any:
    if isinstance(value, Mapping):
        return {key: _redirect(entry, copies) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_redirect(entry, copies) for entry in value]
    return copies.get(Path(value), value) if isinstance(value, str) else value


def _describe_test_case(run: Run, entry: PackedRun, claims: Sequence[Claim]) -> Sheet:
    """Return the sheet of a run with the fields of ISO 34505; some of the ``claims`` rest on it."""
    scenario = run.definition
    assert scenario is not None
    measures = [claim.measure for claim in claims if entry.folder + RESULT in claim.results]
    verdicts = {f"{measure.rule} {measure.bound}": measure.verdict for measure in measures if measure.bound}
    draws, exposure = scenario.simulator.draws, scenario.exposure
    laws = dict(zip(draws.names, draws.laws, strict=True)) if draws is not None else {}
    rules = {name: scenario.specifications[name] for name in run}
    return {
        "id": f"{run.name}@{run.fingerprint}",
        "scenario": entry.folder + SCENARIO,
        "objective": scenario.objective or scenario.description,
        "requirements": list(scenario.requirements),
        "odd": list(scenario.odd),
        "exposure": exposure.model_dump(mode="json", exclude_defaults=True) if exposure else None,
        "complexity": {"drawn_options": len(laws), "components": len(scenario.blocks)},
        "inputs": {
            "stack": {key: block.plugin for key, block in scenario.blocks.items() if "." not in key},
            "rules": {
                name: {"plugin": rule.plugin, **rule.config.model_dump(mode="json", exclude_defaults=True)}
                if isinstance(rule, Block)
                else rule.stl
                for name, rule in rules.items()
            },
            "laws": {name: json.loads(law.model_dump_json(exclude_none=True)) for name, law in laws.items()},
            "files": entry.files,
            "seed": run.seed,
        },
        "steps": {"number": scenario.steps, "dt_seconds": scenario.simulator.config.model_dump().get("dt")},
        "platform": {**run.versions, **run.provenance.to_dict()},
        "expected": list(verdicts),
        "actual": {"estimates": [finite(row) for row in run.table()], "verdicts": verdicts},
    }


def dump_yaml(content: Mapping[str, Any]) -> str:
    """Return plain data as YAML in its order."""
    return yaml.safe_dump(dict(content), sort_keys=False, allow_unicode=True, width=110)


def read_pack(folder: str | os.PathLike[str]) -> Pack:
    """Read a pack, whose files may have changed since.

    Raises:
        UsageError: Its manifest or case is missing or cannot be read.
    """
    path = Path(folder)
    if path.is_dir() and not (path / MANIFEST).exists():
        raise UsageError(
            f"{path}: no {MANIFEST} in it: it is not a pack, or its writing was interrupted", _HINT
        )
    manifest = read_model(Manifest, path / MANIFEST, _HINT)
    try:
        content = yaml.safe_load((path / CASE).read_text(encoding="utf-8"))
        case = TypeAdapter(Case).validate_python({key: content[key] for key in content if key != "module"})
    except (OSError, TypeError, ValueError, yaml.YAMLError) as error:
        raise UsageError(f"{path / CASE}: cannot be read: {error}", _HINT) from None
    return Pack(path, case, manifest)


def hash_file(path: Path) -> str:
    """Return the SHA-256 of a file; "link" for a link, "" for none."""
    if path.is_symlink():
        return "link"
    return hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else ""


def hash_files(folder: Path) -> dict[str, str]:
    """Return the SHA-256 of all files below a folder, by path."""
    paths = sorted(path for path in folder.rglob("*") if path.is_symlink() or path.is_file())
    return {path.relative_to(folder).as_posix(): hash_file(path) for path in paths}


def find_pack_faults(pack: Pack) -> list[str]:
    """Return a line for each file that changed, is missing or was added, and each fault of the argument."""
    files, present = pack.manifest.files, hash_files(pack.folder)
    changes = {"": "is missing", "link": "is a link"}
    faults = [
        f"{name}: {changes.get(present.get(name, ''), 'was changed')}"
        for name in files
        if files[name] != present.get(name)
    ]
    faults += [f"{name}: is not in the manifest" for name in {*present} - {*files, MANIFEST, CONFIRMATION}]
    needed = [
        (f"{MANIFEST}: {run.name}", path)
        for run in pack.manifest.runs
        for path in (run.folder + SCENARIO, run.folder + RESULT, run.scenario, *run.files.values())
    ]
    urls = {key: element.url.partition("#")[0] for key, element in pack.case.items() if element.url}
    needed += [(f"{CASE}: {key}", path) for key, path in urls.items()]
    faults += [
        f"{place} refers to {path}, which has no digest" for place, path in needed if path not in files
    ]
    return faults + [f"{CASE}: {fault}" for fault in find_faults(pack.case)]


def find_version_changes(pack: Pack) -> list[str]:
    """Return a line for each distribution whose installed version is not that of the pack."""
    versions = {name: text for run in pack.manifest.runs for name, text in run.versions.items()}
    installed = {distribution.name: distribution.version for distribution in distributions()}
    return [
        f"{name}: {text} in the pack, {here} here: its results are older or newer than the code"
        for name, text in sorted(versions.items())
        if (here := installed.get(name, "not installed")) != text
    ]
