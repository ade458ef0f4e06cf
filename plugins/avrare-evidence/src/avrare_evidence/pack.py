"""Packs: written from results, and checked file by file."""

from __future__ import annotations

import hashlib
import os
import shlex
import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError
from importlib.metadata import version as find_version
from pathlib import Path
from typing import Any, Literal

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from avrare.base.atomic_files import explain_file_errors, write_text
from avrare.base.errors import UsageError
from avrare.base.stored_files import read_json
from avrare.estimation.loop.checkpoint import SCENARIO
from avrare.results.run import RESULT, Run
from avrare_evidence.claims import Claim, list_claims
from avrare_evidence.gsn import Case, build_case, find_faults
from avrare_evidence.page import write_page
from avrare_evidence.sheets import describe_test_case, name_sheet
from avrare_evidence.sources import Source, list_files, list_models, list_run_files, read_sources, redirect

MANIFEST, CASE, PAGE, CONFIRMATION = "manifest.json", "case.gsn.yaml", "case.md", "confirmation.yaml"
_HINT = "give the folder that `avrare evidence --out` has written, or write it again"


class PackedRun(BaseModel):
    """Run in a pack, as manifest.json lists it; ``files`` and ``models`` are copies by option."""

    model_config = ConfigDict(strict=True, frozen=True, extra="forbid")

    source: str
    folder: str
    fingerprint: str
    seed: int
    budget: str | None
    versions: dict[str, str]
    files: dict[str, str]
    models: dict[str, str]


class Manifest(BaseModel):
    """Content of manifest.json: the runs, and the SHA-256 of every file."""

    model_config = ConfigDict(strict=True, frozen=True, extra="forbid")

    schema_: Literal[1] = Field(alias="schema")
    runs: list[PackedRun] = Field(min_length=1)
    files: dict[str, str]


@dataclass(frozen=True)
class Pack:
    """Pack that was written or read.

    Attributes:
        folder: Its folder.
        case: The argument.
        manifest: Content of manifest.json.
        claims: Claims of the sources; empty for a pack that was read.
    """

    folder: Path
    case: Case
    manifest: Manifest
    claims: tuple[Claim, ...] = ()


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
    claims = [claim for source in sources for claim in list_claims(source)]
    with explain_file_errors(f"{folder}: cannot write the pack", "choose another --out"):
        runs = _copy_sources(sources, folder)
        sheets = {
            name_sheet(source, place): describe_test_case(source, place, run, claims)
            for source in sources
            for place, run in source.runs.items()
        }
        case = build_case(sources, claims, sheets, hash_files(folder))
        seeds = [run.seed for run in runs]
        seed = next(seed for seed in range(1, len(seeds) + 2) if seed not in seeds)
        page = write_page(case, claims, sheets, list(_list_commands(sources, runs)), seed)
        for path, content in {**sheets, CASE: case}.items():
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            write_text(folder / path, dump_yaml(content))
        write_text(folder / PAGE, page)
        manifest = Manifest(schema=1, runs=runs, files=hash_files(folder))
        write_text(folder / MANIFEST, manifest.model_dump_json(indent=2, by_alias=True) + "\n")
    return Pack(folder, case, manifest, tuple(claims))


def _list_commands(sources: Sequence[Source], packed: Sequence[PackedRun]) -> Iterator[str]:
    """Yield the commands that repeat the runs in the folder of the pack."""
    runs = [run for source in sources for run in source.runs.values()]
    for run, entry in zip(runs, packed, strict=True):
        budget = ["--budget", entry.budget] if entry.budget else []
        settings = [word for text in redirect(run.scenario_text, entry.files) for word in ("--set", text)]
        out = f"../repeated/{entry.folder.removeprefix('evidence/').rstrip('/')}"
        yield shlex.join(["avrare", "run", f"{entry.folder}{SCENARIO}", *budget, *settings, "--out", out])


def dump_yaml(content: Mapping[str, Any]) -> str:
    """Return plain data as YAML in its order."""
    return yaml.safe_dump(dict(content), sort_keys=False, allow_unicode=True, width=110)


def _copy_sources(sources: Sequence[Source], folder: Path) -> list[PackedRun]:
    """Copy the files of all sources; those that options name keep their places relative to each other."""
    runs = [(source, place, run) for source in sources for place, run in source.runs.items()]
    named = [path for *_, run in runs for path in list_files(run.definition).values()]
    base = os.path.commonpath([str(path.absolute().parent) for path in named] or ["."])
    for source in sources:
        for name in source.summary and [source.file]:
            _copy(source.folder / name, folder, source.home + name)
    return [_copy_run(source, place, run, folder, base) for source, place, run in runs]


def _copy_run(source: Source, place: str, run: Run, folder: Path, base: str) -> PackedRun:
    for name, path in list_run_files(run).items():
        _copy(path, folder, f"{source.home}{place}{name}")
    files, models = list_files(run.definition), list_models(run.definition)
    places = {option: Path(os.path.relpath(path, base)).as_posix() for option, path in files.items()}
    return PackedRun(
        source=source.name,
        folder=f"{source.home}{place}",
        fingerprint=run.fingerprint,
        seed=run.seed,
        budget=run.provenance.budget,
        versions=dict(run.versions),
        files={key: _copy(path, folder, f"evidence/files/{places[key]}") for key, path in files.items()},
        models={
            key: _copy(path, folder, f"evidence/models/{hash_file(path)[:8]}/{path.name}")
            for key, path in models.items()
        },
    )


def _copy(path: Path, folder: Path, copy: str) -> str:
    """Copy a file and its card, if it has one, to their place in the pack."""
    for suffix in {path.suffix, ".md"}:
        if (origin := path.with_suffix(suffix)).is_file():
            target = (folder / copy).with_suffix(suffix)
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(origin, target)
    return copy


def hash_file(path: Path) -> str:
    """Return the SHA-256 of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def hash_files(folder: Path) -> dict[str, str]:
    """Return the SHA-256 of all files below a folder, by path; "link" for a link."""
    paths = sorted(path for path in folder.rglob("*") if path.is_symlink() or path.is_file())
    return {
        path.relative_to(folder).as_posix(): "link" if path.is_symlink() else hash_file(path)
        for path in paths
    }


def read_pack(folder: str | os.PathLike[str]) -> Pack:
    """Read a pack, whose files may have changed since.

    Raises:
        UsageError: Its manifest or case is missing or cannot be read.
    """
    path = Path(folder)
    if path.is_dir() and not (path / MANIFEST).exists():
        raise UsageError(f"{path}: no {MANIFEST} in it: it is no pack, or its writing was interrupted", _HINT)
    try:
        manifest = Manifest.model_validate(read_json(path / MANIFEST, _HINT))
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(map(str, first["loc"]))
        raise UsageError(f"{path / MANIFEST}: {place}: {first['msg']}", _HINT) from None
    try:
        case = yaml.safe_load((path / CASE).read_text(encoding="utf-8"))
    except (OSError, ValueError, yaml.YAMLError) as error:
        raise UsageError(f"{path / CASE}: cannot be read: {error}", _HINT) from None
    return Pack(path, case if isinstance(case, dict) else {}, manifest)


def find_pack_faults(pack: Pack) -> list[str]:
    """Return a line for each file that changed, is missing or was added, and each fault of the argument."""
    files, present = pack.manifest.files, hash_files(pack.folder)
    for name in (MANIFEST, CONFIRMATION):
        present.pop(name, None)
    faults = [
        f"{name}: {_name_change(files.get(name), present.get(name))}"
        for name in {**files, **present}
        if files.get(name) != present.get(name)
    ]
    for run in pack.manifest.runs:
        needed = [run.folder + name for name in (SCENARIO, RESULT)]
        copies = [*needed, *run.files.values(), *run.models.values()]
        faults += [f"{MANIFEST}: it has no digest of {copy}" for copy in copies if copy not in files]
    faults += [f"{CASE}: {fault}" for fault in find_faults(pack.case)]
    for key, element in pack.case.items():
        url = str(element.get("url", "")).partition("#")[0] if isinstance(element, dict) else ""
        if url and files.get(url) is None:
            faults.append(f"{CASE}: {key} refers to {url}, which is not in the manifest")
        elif url and element.get("sha256", files[url]) != files[url]:
            faults.append(f"{CASE}: {key} has another digest of {url} than the manifest")
    return faults


def _name_change(before: str | None, now: str | None) -> str:
    if before is None:
        return "is not in the manifest"
    return "is missing" if now is None else "is a link" if now == "link" else "was changed"


def find_version_changes(pack: Pack) -> list[str]:
    """Return a line for each distribution whose installed version is not that of the pack."""
    versions = {name: text for run in pack.manifest.runs for name, text in run.versions.items()}
    installed = {name: _find_version(name) for name in sorted(versions)}
    return [
        f"{name}: {versions[name]} in the pack, {text} here: its results are older or newer than the code"
        for name, text in installed.items()
        if text != versions[name]
    ]


def _find_version(distribution: str) -> str:
    try:
        return find_version(distribution)
    except PackageNotFoundError:
        return "not installed"
