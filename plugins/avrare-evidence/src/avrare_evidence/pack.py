"""Packs written from results: evidence, scenarios to repeat, test cases, argument, page and manifest."""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from hashlib import sha256
from itertools import chain
from pathlib import Path
from typing import Any

import yaml

from avrare.base.atomic_files import explain_file_errors, write_text
from avrare.base.errors import UsageError
from avrare.results.run import PROVENANCE, RESULT, Run
from avrare.scenario.yaml import dump
from avrare_evidence.claims import Statement, list_claims, list_premises
from avrare_evidence.gsn import build_case, dump_case
from avrare_evidence.manifest import CASE, Manifest, Pack, PackedRun, hash_file, hash_files
from avrare_evidence.page import PAGE, write_page
from avrare_evidence.sheets import Sheet, describe_test_case
from avrare_evidence.sources import MANIFEST, list_files, read_sources


@dataclass(frozen=True)
class WrittenPack(Pack):
    """Pack with its claims."""

    claims: tuple[Statement, ...]


def write_pack(folders: Sequence[str | os.PathLike[str]], out: str | os.PathLike[str]) -> WrittenPack:
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
    claims = {source.name: list_claims(source) for source in sources}
    with explain_file_errors(f"{folder}: cannot write the pack", "choose another --out"):
        entries, sheets, statements = list[PackedRun](), dict[str, Sheet](), dict[str, list[Statement]]()
        for source in sources:
            if source.file != RESULT:
                _copy(source.folder / source.file, folder, source.home + source.file)
            cases = {}
            for place, run in source.runs.items():
                entry = _copy_run(f"{source.name}/{place}".rstrip("/"), run, folder)
                files = (entry.folder + RESULT, source.home + source.file)
                supported = [claim for claim in claims[source.name] if claim.file in files]
                cases[entry.sheet] = describe_test_case(run, entry, supported)
                entries.append(entry)
            sheets |= cases
            statements[source.name] = [*list_premises(source, cases), *claims[source.name]]
        name = ", ".join(statements)
        case = build_case(name, statements, hash_files(folder))
        page = write_page(name, [*chain(*statements.values())], sheets, case, entries)
        versions = {key: text for entry in entries for key, text in sorted(entry.versions.items())}
        for path, content in {**sheets, CASE: dump_case(name, case, versions)}.items():
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            write_text(folder / path, dump_yaml(content))
        write_text(folder / PAGE, page)
        manifest = Manifest(schema=1, runs=entries, files=hash_files(folder))
        write_text(folder / MANIFEST, manifest.model_dump_json(indent=2, by_alias=True) + "\n")
    return WrittenPack(folder, case, manifest, tuple(chain(*claims.values())))


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
            copy = f"files/{sha256(content.encode()).hexdigest()[:8]}/{places[path]}"
            copies[option] = _copy(path, folder, f"repeat/{copy}")
            if not os.access(path, os.X_OK):  # a program runs where it is installed
                redirected[path] = copy
    budget, versions = run.provenance.budget, dict(run.versions)
    entry = PackedRun(
        name=name, fingerprint=run.fingerprint, seed=run.seed, budget=budget, versions=versions, files=copies
    )
    (folder / entry.scenario).parent.mkdir(exist_ok=True)
    write_text(folder / entry.scenario, dump(_redirect(run.definition.resolved, redirected)))
    return entry


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


def dump_yaml(content: Mapping[str, Any]) -> str:
    """Return plain data as YAML in its order."""
    return yaml.safe_dump(dict(content), sort_keys=False, allow_unicode=True, width=110)
