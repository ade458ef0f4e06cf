"""A checkpoint: what an estimate is about, and the outcome of every chunk that is done, one file each.

    FOLDER/checkpoint.json              the task: what must be equal to go on
    FOLDER/NAME/000012-000003.npz       estimate NAME, stage 12, chunk 3
    FOLDER/SCENARIO/scenario.yaml       of a run: the scenario as it was resolved

An estimate is a deterministic function of its outcomes, so resuming is telling them again. Files are written
whole or not at all, survive a loss of power, and hold arrays only: nothing is ever unpickled.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from avrare.errors import ExitCode, UsageError
from avrare.record.alone import Taken, alone
from avrare.record.checkpoint_chunk import decode, decode_seconds, digest, encode
from avrare.record.whole import write_whole
from avrare.rollout.request import Request, Rollouts

FOLDER = "checkpoint"
INDEX = "checkpoint.json"
SCHEMA = 1
SCENARIO = "scenario.yaml"
_OWN = re.compile(r"\.?(\d{6}-\d{6}\.npz|checkpoint\.json|scenario\.yaml)(\.\w+)?")
"""Names of our files, and of what a killed process was writing."""
_MOST_DIFFERENCES = 5


class SaveError(UsageError):
    """A chunk that could not be saved; all before it are."""

    exit_code = ExitCode.INTERRUPTED


@dataclass(frozen=True)
class Checkpoint:
    """A folder with the outcomes of a task.

    Attributes:
        folder: Where it lies.
        task: What must be equal to go on, as plain JSON data.
    """

    folder: Path
    task: Mapping[str, Any]

    @staticmethod
    def open(folder: Path, task: Mapping[str, Any], about: Mapping[str, Any] | None = None) -> Checkpoint:
        """Go on in ``folder``, or begin there.

        Args:
            folder: Where it lies.
            task: What must be equal to go on, as plain JSON data.
            about: What is worth knowing but may change, likewise.

        Raises:
            UsageError: It holds another task, or the folder cannot be used.
        """
        wanted = json.loads(json.dumps(task))  # tuples become lists, as they do in the file
        stored = read_index(folder)
        if stored is None:
            index = json.dumps({"schema": SCHEMA, "task": wanted, "about": about or {}}, indent=2)
            with _refused(folder):
                folder.mkdir(parents=True, exist_ok=True)
                if not all(_OWN.fullmatch(path.name) for path in folder.iterdir()):
                    raise UsageError(f"{folder}: is not empty, and no checkpoint", "choose another folder")
                write_durably(folder / INDEX, index.encode())
        elif changes := differences(stored["task"], wanted):
            more = len(changes) - _MOST_DIFFERENCES
            listed = "; ".join(changes[:_MOST_DIFFERENCES]) + (f"; and {more} more" if more > 0 else "")
            raise UsageError(
                f"{folder}: this checkpoint is of another estimate: {listed}",
                "undo the change to go on, or choose another folder to start anew",
            )
        return Checkpoint(folder, wanted)

    def journal(self, name: str) -> FileJournal:
        """The outcomes of one of the task's estimates.

        Raises:
            UsageError: The folder cannot be made.
        """
        folder = self.folder / name
        with _refused(folder):
            folder.mkdir(parents=True, exist_ok=True)
            for torn in folder.glob(".*.npz.*"):  # what a killed process was writing
                torn.unlink()
        owner = hashlib.sha256(json.dumps([self.task, name], sort_keys=True).encode()).hexdigest()[:32]
        return FileJournal(folder, owner)

    @property
    def chunks(self) -> int:
        """Chunks that are saved."""
        return sum(1 for _ in self.folder.rglob("*.npz"))

    @contextmanager
    def held(self) -> Iterator[Checkpoint]:
        """Keep others out of the folder: two runs that go on in it would get into each other's way.

        Raises:
            UsageError: Somebody else is at work in it.
        """
        try:
            with _refused(self.folder), alone(self.folder / INDEX):
                yield self
        except Taken:
            raise UsageError(
                f"{self.folder}: another avrare is at work in this folder",
                "wait until it is done, or choose another folder",
            ) from None

    def remove(self) -> None:
        """Take the checkpoint away: its task is done. The index goes last; what is not ours stays."""
        with suppress(OSError):
            for path in sorted(self.folder.rglob("*"), reverse=True):
                if path.is_dir():
                    with suppress(OSError):  # not empty: somebody has put something there
                        path.rmdir()
                elif _OWN.fullmatch(path.name) and path != self.folder / INDEX:
                    path.unlink()
            (self.folder / INDEX).unlink()
            self.folder.rmdir()


@dataclass(frozen=True)
class FileJournal:
    """The outcomes of one estimate (``avrare.estimation.plan.Journal``).

    Attributes:
        folder: Of the files.
        owner: Says whose they are.
    """

    folder: Path
    owner: str

    def read(self, stage: int, index: int, chunk: Request) -> tuple[Rollouts, float] | None:
        """The outcome of a chunk and the seconds that had passed by then; None where it is not kept.

        Raises:
            UsageError: The file is damaged, or of another estimate.
        """
        path = self._path(stage, index)
        try:
            content = path.read_bytes()
        except FileNotFoundError:
            return None
        except OSError as error:
            raise UsageError(f"{path}: cannot be read: {error.strerror}") from None
        try:
            return decode(content, self._key(chunk))
        except ValueError as error:
            hint = "remove this file: its rollouts are then run again"
            raise UsageError(f"{path}: {error}", hint) from None

    def write(self, stage: int, index: int, chunk: Request, outcome: Rollouts, seconds: float) -> None:
        """Keep the outcome of a chunk.

        Raises:
            SaveError: It cannot be written; what was kept before is not touched.
        """
        path = self._path(stage, index)
        try:
            write_durably(path, encode(outcome, self._key(chunk), seconds))
        except OSError as error:
            raise SaveError(
                f"{path}: cannot save: {error.strerror}",
                "make room",
            ) from None

    @property
    def seconds(self) -> float:
        """That the estimate had taken when the newest chunk was kept; 0 where there is none."""
        newest = max(self.folder.glob("*.npz"), default=None)
        try:
            return decode_seconds(newest.read_bytes()) if newest else 0.0
        except (OSError, ValueError):  # told when the chunk is read
            return 0.0

    def _path(self, stage: int, index: int) -> Path:
        return self.folder / f"{stage:06d}-{index:06d}.npz"

    def _key(self, chunk: Request) -> str:
        return f"{self.owner}-{digest(chunk)}"


@contextmanager
def _refused(folder: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise UsageError(
            f"{folder}: cannot save a checkpoint here: {error.strerror}", "choose another folder"
        ) from None


def read_index(folder: Path) -> dict[str, Any] | None:
    """``task`` and ``about`` of the checkpoint in ``folder``, None where there is none.

    Raises:
        UsageError: The index cannot be read.
    """
    path = folder / INDEX
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        schema, index = content["schema"], {key: dict(content[key]) for key in ("task", "about")}
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError as error:
        raise UsageError(f"{path}: cannot be read: {error.strerror}") from None
    except (ValueError, KeyError, TypeError):
        raise UsageError(f"{path}: this is no checkpoint", "start anew in another folder") from None
    if schema != SCHEMA:
        raise UsageError(f"{path}: written by another version of avrare (schema {schema!r})")
    return index


def differences(before: Any, after: Any, path: str = "") -> list[str]:
    """What differs between two values of plain data, for example ``simulator.dt 0.1 -> 0.05``."""
    if isinstance(before, dict) and isinstance(after, dict):
        names = [*before, *(name for name in after if name not in before)]
        return [
            line
            for name in names
            for line in differences(before.get(name), after.get(name), f"{path}.{name}" if path else name)
        ]
    same = json.dumps(before) == json.dumps(after)  # 1 is not 1.0, and NaN is NaN
    return [] if same else list(_change(before, after, path))


def _change(before: Any, after: Any, path: str) -> Iterator[str]:
    if isinstance(before, list) and isinstance(after, list) and len(before) == len(after):
        for index, (one, two) in enumerate(zip(before, after, strict=True)):
            yield from differences(one, two, f"{path}.{index}")
    else:
        yield f"{path} {json.dumps(before)} -> {json.dumps(after)}"


def write_durably(path: Path, content: bytes) -> None:
    """Write a file whole or not at all, so that it is there after a loss of power too.

    Raises:
        OSError: The folder cannot be written to.
    """
    write_whole(path, content, durably=True)
