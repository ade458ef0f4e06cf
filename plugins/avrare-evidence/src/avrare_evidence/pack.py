"""Packs: written from results, and checked file by file."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError
from importlib.metadata import version as find_version
from pathlib import Path
from typing import Any

import yaml

from avrare.base.atomic_files import explain_file_errors, write_text
from avrare.base.errors import UsageError
from avrare.base.stored_files import read_json
from avrare.results.run import Run
from avrare_evidence.claims import Claim, list_claims
from avrare_evidence.gsn import Case, build_case, find_faults
from avrare_evidence.page import write_page
from avrare_evidence.sheets import describe_test_case
from avrare_evidence.sources import Source, list_named_files, list_run_files, read_sources

MANIFEST, CASE, PAGE, CONFIRMATION = "manifest.json", "case.gsn.yaml", "case.md", "confirmation.yaml"
_SCHEMA = 1
_HINT = "give the folder that `avrare evidence --out` has written"


@dataclass(frozen=True)
class Pack:
    """Pack that was written or read.

    Attributes:
        folder: Its folder.
        case: The argument.
        manifest: Content of manifest.json: ``runs``, and ``files`` with the SHA-256 of each.
        claims: Claims of the sources; empty for a pack that was read.
    """

    folder: Path
    case: Case
    manifest: Mapping[str, Any]
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
    with explain_file_errors(f"{folder}: cannot write the pack", "choose another --out"):
        runs = [entry for source in sources for entry in _copy_source(source, folder)]
        claims = tuple(claim for source in sources for claim in list_claims(source))
        case = build_case(sources, claims, hash_files(folder))
        sheets = {
            f"test-cases/{source.name}{'-' + run.name if place else ''}.yaml": dump_yaml(
                describe_test_case(source, place, run, [claim for claim in claims if claim.source is source])
            )
            for source in sources
            for place, run in source.runs.items()
        }
        (folder / "test-cases").mkdir()
        page = write_page(case, sources, claims, list(sheets))
        for path, text in {**sheets, CASE: dump_yaml(case), PAGE: page}.items():
            write_text(folder / path, text)
        manifest = {"schema": _SCHEMA, "runs": runs, "files": hash_files(folder)}
        write_text(folder / MANIFEST, json.dumps(manifest, indent=2) + "\n")
    return Pack(folder, case, manifest, claims)


def dump_yaml(content: Mapping[str, Any]) -> str:
    """Return plain data as YAML in its order."""
    return yaml.safe_dump(dict(content), sort_keys=False, allow_unicode=True, width=110)


def _copy_source(source: Source, folder: Path) -> list[dict[str, Any]]:
    """Copy the files of a source, and return the manifest's entry of each of its runs."""
    (folder / source.home).mkdir(parents=True)
    if source.summary:
        shutil.copyfile(source.folder / source.file, folder / source.home / source.file)
    return [_copy_run(source, place, run, folder) for place, run in source.runs.items()]


def _copy_run(source: Source, place: str, run: Run, folder: Path) -> dict[str, Any]:
    target = folder / source.home / place
    target.mkdir(parents=True, exist_ok=True)
    for name, path in list_run_files(run).items():
        shutil.copyfile(path, target / name)
    assert run.definition is not None
    copies: dict[str, list[str]] = {}
    for option, paths in list_named_files(run.definition).items():
        for path in paths:
            copy = Path("evidence", "files", hash_file(path)[:16], path.name)
            (folder / copy).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, folder / copy)
            copies.setdefault(option, []).append(copy.as_posix())
    return {
        "source": source.name,
        "folder": f"{source.home}{place}",
        "fingerprint": run.fingerprint,
        "seed": run.seed,
        "budget": run.provenance.budget,
        "versions": dict(run.versions),
        "named_files": copies,
    }


def hash_file(path: Path) -> str:
    """Return the SHA-256 of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def hash_files(folder: Path) -> dict[str, str]:
    """Return the SHA-256 of all files below a folder, by path."""
    paths = sorted(path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): hash_file(path) for path in paths}


def read_pack(folder: str | os.PathLike[str]) -> Pack:
    """Read a pack, whose files may have changed since.

    Raises:
        UsageError: Its manifest or case is missing or cannot be read.
    """
    path = Path(folder)
    manifest = read_json(path / MANIFEST, _HINT)
    if manifest.get("schema") != _SCHEMA or not isinstance(manifest.get("files"), dict):
        raise UsageError(f"{path / MANIFEST}: this is not the manifest of a pack", _HINT)
    try:
        case = yaml.safe_load((path / CASE).read_text(encoding="utf-8"))
    except (OSError, ValueError, yaml.YAMLError) as error:
        raise UsageError(f"{path / CASE}: cannot be read: {error}", _HINT) from None
    return Pack(path, case if isinstance(case, dict) else {}, manifest)


def find_pack_faults(pack: Pack) -> list[str]:
    """Return a line for each file that changed, is missing or was added, and each fault of the argument."""
    files, present = pack.manifest["files"], hash_files(pack.folder)
    faults = [f"{name}: is missing" for name in files if name not in present]
    faults += [
        f"{name}: was changed" for name, digest in files.items() if present.get(name, digest) != digest
    ]
    allowed = {MANIFEST, CONFIRMATION, *files}
    faults += [f"{name}: is not in the manifest" for name in present if name not in allowed]
    faults += [f"{CASE}: {fault}" for fault in find_faults(pack.case)]
    for key, element in pack.case.items():
        url = str(element.get("url", "")).partition("#")[0] if isinstance(element, dict) else ""
        if url and files.get(url) is None:
            faults.append(f"{CASE}: {key} refers to {url}, which is not in the manifest")
        elif url and element.get("sha256", files[url]) != files[url]:
            faults.append(f"{CASE}: {key} has another digest of {url} than the manifest")
    return faults


def find_version_changes(pack: Pack) -> list[str]:
    """Return a line for each distribution whose installed version is not that of the pack."""
    lines = []
    versions = {name: text for run in pack.manifest["runs"] for name, text in run["versions"].items()}
    for name, text in sorted(versions.items()):
        try:
            installed = find_version(name)
        except PackageNotFoundError:
            installed = "not installed"
        if installed != text:
            lines.append(
                f"{name}: {text} in the pack, {installed} here: its results are older or newer than the code"
            )
    return lines
