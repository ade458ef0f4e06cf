"""Manifest of a pack: its runs and the SHA-256 of every file; the files as they are now."""

from __future__ import annotations

import hashlib
import os
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError
from importlib.metadata import version as find_version
from pathlib import Path
from typing import Literal

import yaml
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter

from avrare.base.errors import UsageError
from avrare.estimation.loop.checkpoint import SCENARIO
from avrare.results.run import RESULT
from avrare_evidence.gsn import Case, find_faults
from avrare_evidence.sources import MANIFEST, read_model

CASE, CONFIRMATION = "case.gsn.yaml", "confirmation.yaml"
_HINT = "give the folder that `avrare evidence --out` has written, or write it again"


class PackedRun(BaseModel):
    """Run in a pack; ``files`` has the copies of files and models by the option that names them."""

    model_config = ConfigDict(strict=True, frozen=True, extra="forbid")

    name: str
    fingerprint: str
    seed: int
    budget: str | None
    versions: dict[str, str]
    files: dict[str, str]

    @property
    def folder(self) -> str:
        """Folder of its result."""
        return f"evidence/{self.name}/"

    @property
    def sheet(self) -> str:
        """Sheet of its test case."""
        return f"test-cases/{self.name}.yaml"

    @property
    def scenario(self) -> str:
        """Scenario that names the files of the pack, beside the folder that holds them."""
        return f"repeat/{self.name.replace('/', '+')}.yaml"


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


def read_pack(folder: str | os.PathLike[str]) -> Pack:
    """Read a pack, whose files may have changed since.

    Raises:
        UsageError: Its manifest or case is missing or cannot be read.
    """
    path = Path(folder)
    if path.is_dir() and not (path / MANIFEST).exists():
        raise UsageError(f"{path}: no {MANIFEST} in it: it is no pack, or its writing was interrupted", _HINT)
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
    faults = [
        f"{name}: {_name_change(files.get(name), present.get(name))}"
        for name in {**files, **present}
        if files.get(name) != present.get(name) and name not in (MANIFEST, CONFIRMATION)
    ]
    needed = [
        (f"{MANIFEST}: {run.name}", path)
        for run in pack.manifest.runs
        for path in (run.folder + SCENARIO, run.folder + RESULT, run.scenario, *run.files.values())
    ]
    needed += [
        (f"{CASE}: {key}", element.url.partition("#")[0]) for key, element in pack.case.items() if element.url
    ]
    faults += [
        f"{place} refers to {path}, which has no digest" for place, path in needed if path not in files
    ]
    return faults + [f"{CASE}: {fault}" for fault in find_faults(pack.case)]


def _name_change(before: str | None, now: str | None) -> str:
    if before is None:
        return "is not in the manifest"
    return "is missing" if now is None else "is a link" if now == "link" else "was changed"


def find_version_changes(pack: Pack) -> list[str]:
    """Return a line for each distribution whose installed version is not that of the pack."""
    versions = {name: text for run in pack.manifest.runs for name, text in run.versions.items()}
    return [
        f"{name}: {versions[name]} in the pack, {installed} here: results and code differ in age"
        for name in sorted(versions)
        if (installed := _find_version(name)) != versions[name]
    ]


def _find_version(distribution: str) -> str:
    try:
        return find_version(distribution)
    except PackageNotFoundError:
        return "not installed"
