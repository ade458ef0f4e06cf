"""Checkpoint folder: the identity of an estimate and the outcome of every finished chunk, one file each.

    FOLDER/checkpoint.json              the task: what must be equal to resume
    FOLDER/NAME/000012-000003.npz       estimate NAME, stage 12, chunk 3
    FOLDER/SCENARIO/scenario.yaml       of `avrare run`: the resolved scenario

An estimate is a deterministic function of its outcomes, so it resumes by reading them in order. Files are
written atomically, survive a loss of power, and hold arrays only: nothing is ever unpickled.
"""

from __future__ import annotations

import hashlib
import io
import json
import re
import shlex
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from avrare.base.atomic_files import LockHeld, exclusive_lock, explain_file_errors, write_atomic
from avrare.base.errors import AvrareError, ExitCode, UsageError
from avrare.base.stored_files import Arrays, check_seal, parse_arrays, read_json, read_regular, seal
from avrare.estimation.plan.plan import StoredChunk
from avrare.rollout.request import ARRAYS, WANTED_ARRAYS, Request, Rollouts
from avrare.scenario.safe_mode import is_safe

FOLDER = "checkpoint"
INDEX = "checkpoint.json"
SCHEMA = 1
"""Since 2 each chunk has a checksum; 1 is read."""
SCENARIO = "scenario.yaml"
_OWN_FILES = re.compile(r"\.?(\d{6}-\d{6}\.npz|checkpoint\.json|scenario\.yaml)(\.\w+){0,2}")
"""Names of checkpoint files, and of temporary ones that a killed process has left."""
_AFRESH = "start afresh in another folder"

# Members of a chunk's file, beside ``ARRAYS`` and the counters.
_KEY, _SECONDS, _STEPS, _EVERY, _MESSAGES = "key", "seconds", "simulated_steps", "every", "messages"
_CHECKSUM = "checksum"
_COUNT = "count."


class SaveError(UsageError):
    """Failure to save a chunk; all chunks before it are saved."""

    exit_code = ExitCode.INTERRUPTED


@dataclass(frozen=True)
class Checkpoint:
    """Folder with the saved outcomes of a task, which is identified by plain JSON data."""

    folder: Path
    task: Mapping[str, Any]

    @staticmethod
    def open(
        folder: Path,
        task: Mapping[str, object],
        about: Mapping[str, object] | None = None,
        files: Mapping[str, bytes] | None = None,
    ) -> Checkpoint:
        """Resume the checkpoint in ``folder`` if its task is equal, or create it; ``about`` may differ.

        ``files`` are written before the index, with which the checkpoint begins: without one, what a killed
        process has left in the folder is removed.
        """
        identity = json.loads(json.dumps(task))  # tuples become lists, as they do in the file
        stored = read_index(folder)
        if stored is None:
            index = json.dumps(seal({"schema": SCHEMA, "task": identity, "about": about or {}}), indent=2)
            with _explain_folder_errors(folder):
                folder.mkdir(parents=True, exist_ok=True)
                if not all(path.is_dir() or _OWN_FILES.fullmatch(path.name) for path in folder.rglob("*")):
                    raise UsageError(f"{folder}: is not empty and not a checkpoint", "choose another folder")
                _remove_own_files(folder)
                for name, content in (files or {}).items():
                    (folder / name).parent.mkdir(parents=True, exist_ok=True)
                    write_atomic(folder / name, content, durable=True)
                write_atomic(folder / INDEX, index.encode(), durable=True)
        elif changes := differences(stored["task"], identity):
            limit = 5
            more = len(changes) - limit
            listed = "; ".join(changes[:limit]) + (f"; and {more} more" if more > 0 else "")
            raise UsageError(
                f"{folder}: this checkpoint belongs to another estimate: {listed}",
                "undo the change to resume, or choose another folder to start afresh",
            )
        return Checkpoint(folder, identity if stored is None else stored["task"])

    def journal(self, name: str) -> FileJournal:
        """Return the journal of one of the estimates of the task."""
        folder = _prepare_folder(self.folder / name)
        owner = hashlib.sha256(json.dumps([self.task, name], sort_keys=True).encode()).hexdigest()[:32]
        return FileJournal(folder, owner)

    @property
    def chunks(self) -> int:
        """Number of saved chunks."""
        return sum(1 for _ in self.folder.rglob("*.npz"))

    @contextmanager
    def hold(self) -> Iterator[Checkpoint]:
        """Hold the lock of the folder: two processes must not resume in it at once.

        An estimate that is refused before its first chunk leaves no checkpoint.
        """
        with ExitStack() as held:
            try:
                with _explain_folder_errors(self.folder):
                    held.enter_context(exclusive_lock(self.folder / INDEX))
            except LockHeld:
                raise UsageError(
                    f"{self.folder}: another process is using this folder",
                    "wait until it ends, or choose another folder",
                ) from None
            try:
                yield self
            except AvrareError as error:
                if error.exit_code in (ExitCode.USAGE, ExitCode.PLUGIN) and not self.chunks:
                    self.remove()
                raise

    def remove(self) -> None:
        """Delete the checkpoint, the index first; files of others in the folder stay."""
        with suppress(OSError):
            (self.folder / INDEX).unlink(missing_ok=True)
            _remove_own_files(self.folder)
            self.folder.rmdir()


@dataclass(frozen=True)
class FileJournal:
    """Outcomes of one estimate (``avrare.estimation.plan.plan.Journal``)."""

    folder: Path
    owner: str  # identity of the estimate, part of every key

    def read(self, stage: int, request: Request) -> Iterator[StoredChunk]:
        """Yield the stored chunks of a stage's request, in order."""
        at = index = 0
        while at < request.rows and (path := self._path(stage, index)).exists():
            try:
                with explain_file_errors(f"{path}: cannot be read"):
                    outcome, seconds, key = decode(read_regular(path))
                chunk = request.slice(at, at + len(outcome.error))
                if key != self._key(chunk):
                    raise ValueError("the chunk belongs to another estimate")
            except ValueError as error:
                hint = "remove this file: its rollouts are then run again"
                raise UsageError(f"{path}: {error}", hint) from None
            yield StoredChunk(chunk, outcome, seconds)
            at, index = at + chunk.rows, index + 1

    def part(self, name: str) -> FileJournal:
        """Return the journal of a part of the estimate, in its own folder."""
        owner = hashlib.sha256(f"{self.owner} {name}".encode()).hexdigest()[:32]
        return FileJournal(_prepare_folder(self.folder / name), owner)

    def has(self, stage: int) -> bool:
        """Return whether chunks of a stage are stored."""
        return self._path(stage, 0).exists()

    def write(self, stage: int, index: int, chunk: Request, outcome: Rollouts, seconds: float) -> None:
        """Store the outcome of a chunk; a failure does not touch those stored before."""
        path = self._path(stage, index)
        with explain_file_errors(f"{path}: cannot save", "free some disk space", SaveError):
            write_atomic(path, encode(outcome, self._key(chunk), seconds), durable=True)

    @property
    def seconds(self) -> float:
        """Wall time of the estimate and its parts when their newest chunks were stored [s]."""
        folders = [self.folder, *(path for path in self.folder.iterdir() if path.is_dir())]
        return sum(map(_newest_seconds, folders))

    def _path(self, stage: int, index: int) -> Path:
        return self.folder / f"{stage:06d}-{index:06d}.npz"

    def _key(self, chunk: Request) -> str:
        return f"{self.owner}-{digest(chunk)}"


def _prepare_folder(folder: Path) -> Path:
    with _explain_folder_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
        for temporary in folder.glob(".*.npz.*"):  # left by a killed process
            temporary.unlink()
    return folder


def _newest_seconds(folder: Path) -> float:
    newest = max(folder.glob("*.npz"), default=None)
    try:
        return decode(read_regular(newest))[1] if newest else 0.0
    except (OSError, ValueError):  # reported when the chunk is read
        return 0.0


def _remove_own_files(folder: Path) -> None:
    for path in sorted(folder.rglob("*"), reverse=True):
        if path.is_dir():
            with suppress(OSError):  # not empty: it holds files of others
                path.rmdir()
        elif _OWN_FILES.fullmatch(path.name):
            path.unlink()


def _explain_folder_errors(folder: Path) -> AbstractContextManager[None]:
    return explain_file_errors(f"{folder}: cannot save a checkpoint here", "choose another folder")


def read_index(folder: Path) -> dict[str, Any] | None:
    """Return ``schema``, ``task`` and ``about`` of a checkpoint in ``folder``, None where there is none."""
    path = folder / INDEX
    with explain_file_errors(f"{path}: cannot be read"):
        if not path.exists():
            return None
    index = read_json(path, _AFRESH)
    if not all(isinstance(index.get(key), dict) for key in ("task", "about")):
        raise UsageError(f"{path}: this is not a checkpoint", _AFRESH)
    if index.get("schema") != SCHEMA:
        text = f"{path}: written by another version of avrare (schema {index.get('schema')!r})"
        raise UsageError(text, "resume with that version, or start afresh in another folder")
    check_seal(path, index, f"restore the file, or {_AFRESH}")
    return index


def resume_hint(out: Path) -> str:
    """Return how the run, or the check, that was interrupted in ``out`` is resumed."""
    options = shlex.join(["--out", str(out), "--resume", *(["--safe"] if is_safe() else [])])
    with suppress(UsageError):  # a damaged index is told when it is read
        index = read_index(out / FOLDER)
        if index is not None and "check" in index["task"]:
            return f"resume with the same avrare check command and {options}"
    return f"resume with avrare run {options}"


def differences(before: object, after: object, path: str = "") -> list[str]:
    """List the differences of two values of plain data, for example ``simulator.dt 0.1 -> 0.05``."""
    if isinstance(before, dict) and isinstance(after, dict):
        names = dict.fromkeys([*before, *after])
        parts = [(name, before.get(name), after.get(name)) for name in names]
    elif isinstance(before, list) and isinstance(after, list) and len(before) == len(after):
        parts = [(str(i), old, new) for i, (old, new) in enumerate(zip(before, after, strict=True))]
    else:
        old, new = json.dumps(before), json.dumps(after)  # 1 is not 1.0, and NaN is NaN
        return [f"{path} {old} -> {new}"] if old != new else []
    prefix = f"{path}." if path else ""
    return [line for name, old, new in parts for line in differences(old, new, prefix + name)]


def digest(chunk: Request) -> str:
    """Return 32 hexadecimal digits that identify the request of a chunk.

    They stand for addresses, starts, ancestors and given noise.
    """
    hashed = hashlib.blake2b(digest_size=16)
    for values in (chunk.run, chunk.stage, chunk.particle, chunk.start):
        hashed.update(np.ascontiguousarray(values, dtype=np.int64).tobytes())
    if chunk.tape is not None:
        hashed.update(np.ascontiguousarray(chunk.tape).tobytes())
    hashed.update(f"{chunk.rows} {chunk.stop_early} {chunk.law is not None}".encode())
    if chunk.until is not None or chunk.observe:
        hashed.update(f"{chunk.until} {chunk.observe} {chunk.stop_failed}".encode())
    if chunk.lineage is not None:
        hashed.update(f"{chunk.lineage.shape}".encode())
        hashed.update(np.ascontiguousarray(chunk.lineage, dtype=np.int64).tobytes())
    if chunk.tape_law is not None:
        hashed.update(chunk.tape_law.digest.encode())
    return hashed.hexdigest()


def encode(outcome: Rollouts, key: str, seconds: float) -> bytes:
    """Encode an outcome as an ``.npz`` file, without its carries and without pickled objects."""
    arrays: dict[str, Any] = {name: getattr(outcome, name) for name in ARRAYS}
    arrays |= {name: values for name in WANTED_ARRAYS if (values := getattr(outcome, name)).shape[1]}
    arrays |= {_COUNT + name: values for name, values in outcome.counts.items()}
    arrays |= {
        _KEY: np.array(key),
        _SECONDS: np.array(seconds),
        _STEPS: np.array(outcome.simulated_steps),
        _EVERY: np.array(outcome.every),
        _MESSAGES: np.array(outcome.messages, dtype=np.str_),
    }
    arrays[_CHECKSUM] = np.array(_checksum(arrays))
    content = io.BytesIO()
    np.savez(content, **arrays)
    return content.getvalue()


def decode(content: bytes) -> tuple[Rollouts, float, str]:
    """Return outcome, seconds and key; ValueError if they are damaged."""
    arrays = _arrays(content)
    missing = {*ARRAYS, _STEPS, _EVERY, _MESSAGES, _KEY, _SECONDS} - set(arrays)
    if missing:
        raise ValueError(f"damaged: {', '.join(sorted(missing))} is missing")
    if str(arrays.pop(_CHECKSUM, None)) != _checksum(arrays):
        raise ValueError("damaged: its checksum does not fit")
    counts = {name.removeprefix(_COUNT): v for name, v in arrays.items() if name.startswith(_COUNT)}
    fields: dict[str, Any] = {name: arrays[name] for name in ARRAYS}
    rows = len(arrays["error"])
    empty = {"features": np.zeros((rows, 0, 0)), "evidence": np.zeros((rows, 0))}
    fields |= {name: arrays.get(name, empty[name]) for name in WANTED_ARRAYS}
    outcome = Rollouts(
        **fields,
        simulated_steps=int(arrays[_STEPS]),
        every=int(arrays[_EVERY]),
        counts=counts,
        messages=tuple(str(text) for text in arrays[_MESSAGES]),
    )
    return outcome, float(arrays[_SECONDS]), str(arrays[_KEY])


def _checksum(arrays: Arrays) -> str:
    hashed = hashlib.blake2b(digest_size=16)
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        hashed.update(f"{name} {array.dtype.str} {arrays[name].shape} ".encode() + array.tobytes())
    return hashed.hexdigest()


def _arrays(content: bytes) -> Arrays:
    try:
        return parse_arrays(content)
    except ValueError as error:
        raise ValueError(f"damaged: {error}") from None
