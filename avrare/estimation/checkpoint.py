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
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from avrare.base.atomic_files import LockHeld, exclusive_lock, explain_file_errors, write_atomic
from avrare.base.errors import ExitCode, UsageError
from avrare.rollout.request import ARRAYS, Request, Rollouts

FOLDER = "checkpoint"
INDEX = "checkpoint.json"
SCHEMA = 1
SCENARIO = "scenario.yaml"
_OWN_FILES = re.compile(r"\.?(\d{6}-\d{6}\.npz|checkpoint\.json|scenario\.yaml)(\.\w+)?")
"""Names of checkpoint files, and of temporary ones that a killed process has left."""
_MAX_DIFFERENCES = 5

# Members of a chunk's file, beside ``ARRAYS`` and the counters.
_KEY, _SECONDS, _STEPS, _EVERY, _MESSAGES = "key", "seconds", "simulated_steps", "every", "messages"
_COUNT = "count."


class SaveError(UsageError):
    """Failure to save a chunk; all chunks before it are saved."""

    exit_code = ExitCode.INTERRUPTED


@dataclass(frozen=True)
class Checkpoint:
    """A folder with the outcomes of a task: the identity of the estimate, as plain JSON data."""

    folder: Path
    task: Mapping[str, Any]

    @staticmethod
    def open(folder: Path, task: Mapping[str, Any], about: Mapping[str, Any] | None = None) -> Checkpoint:
        """Resume the checkpoint in ``folder`` if its task is equal, or create it; ``about`` may differ."""
        wanted = json.loads(json.dumps(task))  # tuples become lists, as they do in the file
        stored = read_index(folder)
        if stored is None:
            index = json.dumps({"schema": SCHEMA, "task": wanted, "about": about or {}}, indent=2)
            with _explain_folder_errors(folder):
                folder.mkdir(parents=True, exist_ok=True)
                if not all(_OWN_FILES.fullmatch(path.name) for path in folder.iterdir()):
                    raise UsageError(f"{folder}: is not empty and not a checkpoint", "choose another folder")
                write_atomic(folder / INDEX, index.encode(), durable=True)
        elif changes := differences(stored["task"], wanted):
            more = len(changes) - _MAX_DIFFERENCES
            listed = "; ".join(changes[:_MAX_DIFFERENCES]) + (f"; and {more} more" if more > 0 else "")
            raise UsageError(
                f"{folder}: this checkpoint belongs to another estimate: {listed}",
                "undo the change to resume, or choose another folder to start afresh",
            )
        return Checkpoint(folder, wanted)

    def journal(self, name: str) -> FileJournal:
        """Return the journal of one of the estimates of the task."""
        folder = self.folder / name
        with _explain_folder_errors(folder):
            folder.mkdir(parents=True, exist_ok=True)
            for temporary in folder.glob(".*.npz.*"):  # left by a killed process
                temporary.unlink()
        owner = hashlib.sha256(json.dumps([self.task, name], sort_keys=True).encode()).hexdigest()[:32]
        return FileJournal(folder, owner)

    @property
    def chunks(self) -> int:
        """Number of saved chunks."""
        return sum(1 for _ in self.folder.rglob("*.npz"))

    @contextmanager
    def held(self) -> Iterator[Checkpoint]:
        """Hold the lock of the folder: two processes must not resume in it at once."""
        try:
            with _explain_folder_errors(self.folder), exclusive_lock(self.folder / INDEX):
                yield self
        except LockHeld:
            raise UsageError(
                f"{self.folder}: another process is using this folder",
                "wait until it ends, or choose another folder",
            ) from None

    def remove(self) -> None:
        """Delete the checkpoint, the index last; files of others in the folder stay."""
        with suppress(OSError):
            for path in sorted(self.folder.rglob("*"), reverse=True):
                if path.is_dir():
                    with suppress(OSError):  # not empty: it holds files of others
                        path.rmdir()
                elif _OWN_FILES.fullmatch(path.name) and path != self.folder / INDEX:
                    path.unlink()
            (self.folder / INDEX).unlink()
            self.folder.rmdir()


@dataclass(frozen=True)
class FileJournal:
    """Outcomes of one estimate (``avrare.estimation.plan.Journal``)."""

    folder: Path
    owner: str  # identity of the estimate, part of every key

    def read(self, stage: int, index: int, chunk: Request) -> tuple[Rollouts, float] | None:
        """Return the outcome of a chunk and the seconds until then [s], None where it is not stored."""
        path = self._path(stage, index)
        with explain_file_errors(f"{path}: cannot be read"):
            if not path.exists():
                return None
            content = path.read_bytes()
        try:
            return decode(content, self._key(chunk))
        except ValueError as error:
            hint = "remove this file: its rollouts are then run again"
            raise UsageError(f"{path}: {error}", hint) from None

    def write(self, stage: int, index: int, chunk: Request, outcome: Rollouts, seconds: float) -> None:
        """Store the outcome of a chunk; a failure does not touch those stored before."""
        path = self._path(stage, index)
        with explain_file_errors(f"{path}: cannot save", "free some disk space", SaveError):
            write_atomic(path, encode(outcome, self._key(chunk), seconds), durable=True)

    @property
    def seconds(self) -> float:
        """Wall time of the estimate when the newest chunk was stored [s]; 0 where there is none."""
        newest = max(self.folder.glob("*.npz"), default=None)
        try:
            return decode_seconds(newest.read_bytes()) if newest else 0.0
        except (OSError, ValueError):  # reported when the chunk is read
            return 0.0

    def _path(self, stage: int, index: int) -> Path:
        return self.folder / f"{stage:06d}-{index:06d}.npz"

    def _key(self, chunk: Request) -> str:
        return f"{self.owner}-{digest(chunk)}"


def _explain_folder_errors(folder: Path) -> AbstractContextManager[None]:
    return explain_file_errors(f"{folder}: cannot save a checkpoint here", "choose another folder")


def read_index(folder: Path) -> dict[str, Any] | None:
    """Return ``task`` and ``about`` of the checkpoint in ``folder``, None where there is none."""
    path = folder / INDEX
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        schema, index = content["schema"], {key: dict(content[key]) for key in ("task", "about")}
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError as error:
        raise UsageError(f"{path}: cannot be read: {error.strerror}") from None
    except (ValueError, KeyError, TypeError):
        raise UsageError(f"{path}: this is not a checkpoint", "start afresh in another folder") from None
    if schema != SCHEMA:
        raise UsageError(f"{path}: written by another version of avrare (schema {schema!r})")
    return index


def differences(before: Any, after: Any, path: str = "") -> list[str]:
    """List the differences of two values of plain data, for example ``simulator.dt 0.1 -> 0.05``."""
    if isinstance(before, dict) and isinstance(after, dict):
        names = dict.fromkeys([*before, *after])
        parts = [(name, before.get(name), after.get(name)) for name in names]
    elif isinstance(before, list) and isinstance(after, list) and len(before) == len(after):
        parts = [(str(i), one, two) for i, (one, two) in enumerate(zip(before, after, strict=True))]
    else:
        old, new = json.dumps(before), json.dumps(after)  # 1 is not 1.0, and NaN is NaN
        return [f"{path} {old} -> {new}"] if old != new else []
    prefix = f"{path}." if path else ""
    return [line for name, one, two in parts for line in differences(one, two, prefix + name)]


def digest(chunk: Request) -> str:
    """Return 32 hexadecimal digits that identify the request of a chunk: addresses, starts, given noise."""
    hashed = hashlib.blake2b(digest_size=16)
    for values in (chunk.run, chunk.stage, chunk.particle, chunk.start):
        hashed.update(np.ascontiguousarray(values, dtype=np.int64).tobytes())
    if chunk.tape is not None:
        hashed.update(np.ascontiguousarray(chunk.tape).tobytes())
    hashed.update(f"{chunk.rows} {chunk.stop_early} {chunk.law is not None}".encode())
    return hashed.hexdigest()


def encode(outcome: Rollouts, key: str, seconds: float) -> bytes:
    """Encode an outcome as an ``.npz`` file, without its carries and without pickled objects."""
    arrays: dict[str, Any] = {name: getattr(outcome, name) for name in ARRAYS}
    arrays |= {_COUNT + name: values for name, values in outcome.counts.items()}
    arrays |= {
        _KEY: np.array(key),
        _SECONDS: np.array(seconds),
        _STEPS: np.array(outcome.simulated_steps),
        _EVERY: np.array(outcome.every),
        _MESSAGES: np.array(outcome.messages, dtype=np.str_),
    }
    content = io.BytesIO()
    np.savez(content, **arrays)
    return content.getvalue()


def decode(content: bytes, key: str) -> tuple[Rollouts, float]:
    """Return outcome and seconds; ValueError if they are damaged or of another estimate or chunk."""
    arrays = _arrays(content)
    try:
        outcome = Rollouts(
            **{name: arrays[name] for name in ARRAYS},
            simulated_steps=int(arrays[_STEPS]),
            every=int(arrays[_EVERY]),
            counts={n.removeprefix(_COUNT): v for n, v in arrays.items() if n.startswith(_COUNT)},
            messages=tuple(str(text) for text in arrays[_MESSAGES]),
        )
        found, seconds = str(arrays[_KEY]), float(arrays[_SECONDS])
    except (ValueError, KeyError, TypeError) as error:
        raise ValueError(f"not an outcome of rollouts: {error}") from None
    if found != key:
        raise ValueError("the chunk belongs to another estimate")
    return outcome, seconds


def decode_seconds(content: bytes) -> float:
    """Return only the seconds, 0 where they are missing; ValueError if the bytes are damaged."""
    arrays = _arrays(content)
    return float(arrays[_SECONDS]) if _SECONDS in arrays else 0.0


def _arrays(content: bytes) -> dict[str, Any]:
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as file:
            return {name: file[name] for name in file.files}
    except Exception as error:  # zipfile and NumPy raise many kinds of errors for a damaged file
        raise ValueError(f"damaged: {' '.join(str(error).split())}") from None
