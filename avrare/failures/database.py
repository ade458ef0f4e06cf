"""A folder of failures, one small file each, named by the failure's id."""

from __future__ import annotations

import io
import json
import os
import re
from pathlib import Path

import numpy as np

from avrare.errors import UsageError
from avrare.failures.failure import Failure
from avrare.failures.pack import Broken, packed_from, read_header, unpacked
from avrare.record.whole import write_whole
from avrare.record.written import read_arrays

DEFAULT = Path(".avrare") / "failures"
"""Where failures are kept unless told otherwise."""

_ID = re.compile(r"[0-9a-f]{1,8}")


class Database:
    """The failures in a folder.

    Args:
        folder: Made when the first failure is added.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def ids(self) -> list[str]:
        """Of all failures, in order."""
        found = (path.stem for path in self.folder.glob("*.npz"))
        return sorted(name for name in found if len(name) == 8 and _ID.fullmatch(name))

    def check(self) -> None:
        """Whether failures can be added, asked before long work is done for them.

        Raises:
            UsageError: They cannot.
        """
        place = next(path for path in (self.folder, *self.folder.absolute().parents) if path.exists())
        if not place.is_dir() or not os.access(place, os.W_OK | os.X_OK):
            reason = f"{place} is no folder that can be written to"
            raise UsageError(f"{self.folder}: {reason}", "choose another folder of failures")

    def add(self, failure: Failure) -> bool:
        """Keep a failure; False: it was there already.

        Raises:
            UsageError: The folder cannot be written to.
        """
        path = self.folder / f"{failure.id}.npz"
        if path.exists():
            return False
        header, arrays = unpacked(failure)
        content = io.BytesIO()
        np.savez_compressed(content, header=np.array(json.dumps(header)), **arrays)  # type: ignore[arg-type]
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            write_whole(path, content.getvalue())
        except OSError as error:
            text = f"{self.folder}: cannot write: {error.strerror or error}"
            raise UsageError(text, "choose another folder of failures") from error
        return True

    def load(self, name: str) -> Failure:
        """The failure of an id, of which the first digits are enough.

        Raises:
            UsageError: There is none, or several, or its file is damaged.
        """
        found = [one for one in self.ids() if one.startswith(name)] if _ID.fullmatch(name) else []
        if not found:
            known = self.ids()
            listing = ", ".join(known[:8]) + (", ..." if len(known) > 8 else "")
            hint = f"there are: {listing}" if known else "it is empty; `avrare run --failures DIR` fills it"
            raise UsageError(f"{self.folder}: there is no failure {name!r}", hint)
        if len(found) > 1:
            raise UsageError(f"{self.folder}: {name!r} is not enough", f"it may be {', '.join(found[:8])}")
        return self._read(self.folder / f"{found[0]}.npz")

    def all(self, scenario: str | None = None) -> tuple[list[Failure], list[str]]:
        """All failures, or those of one scenario's name, by id; and a message for each damaged file.

        They come without their signals, which take more room than the noise.
        """
        failures, complaints = [], []
        for name in self.ids():
            try:
                failure = self._read(self.folder / f"{name}.npz")
            except UsageError as error:
                complaints.append(error.message)
                continue
            if scenario is None or failure.scenario == scenario:
                failures.append(failure.bare)
        return failures, complaints

    def _read(self, path: Path) -> Failure:
        arrays = read_arrays(path, "remove the file")
        try:
            failure = packed_from(read_header(str(arrays.pop("header", ""))), arrays)
        except Broken as error:
            raise UsageError(f"{path}: damaged: {error}", "remove the file") from None
        if failure.id != path.stem:
            text = f"{path}: damaged: it holds failure {failure.id}"
            raise UsageError(text, "give the file its name back, or remove it")
        return failure
