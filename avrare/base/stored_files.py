"""Strict readers of JSON and npz files, which may be damaged or untrusted.

Bounded in size and depth, nothing is ever unpickled. ``parse_...`` raise ``ValueError``, ``read_...`` say
which file it is.
"""

from __future__ import annotations

import errno
import hashlib
import io
import json
import os
import stat
import sys
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, TypeAlias, TypeVar

from avrare.base.atomic_files import write_atomic
from avrare.base.errors import UsageError

if TYPE_CHECKING:  # rules and formulas are read without arrays
    from numpy.typing import NDArray
    from pydantic import BaseModel

Arrays: TypeAlias = "dict[str, NDArray[Any]]"
_Content = TypeVar("_Content")
_Model = TypeVar("_Model", bound="BaseModel")
CHECKSUM = "checksum"
"""Key of the checksum of a JSON object."""
MOST_BYTES = 2**32
"""Bytes of any other file."""
_MAX_EXPANDED_BYTES = 2**30
"""Bytes to which a small npz file may expand."""


def read_json(path: Path, hint: str) -> dict[str, Any]:
    """Read a file that holds a JSON object."""
    return _explain_errors(path, hint, lambda: parse_json(read_regular(path, 2**26)))


def read_model(model: type[_Model], path: Path, hint: str) -> _Model:
    """Read a JSON file as its model."""
    return check_model(model, read_json(path, hint), path, hint)


def check_model(model: type[_Model], content: Mapping[str, object], path: Path, hint: str) -> _Model:
    """Return the content of a file as its model; a ``UsageError`` names the first value that does not fit."""
    from pydantic import ValidationError

    try:
        return model.model_validate(content)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(map(str, first["loc"]))
        raise UsageError(f"{path}: it cannot be read: {place}: {first['msg']}", hint) from None


def read_arrays(path: Path, hint: str) -> Arrays:
    """Read all arrays of an npz file."""
    return _explain_errors(path, hint, lambda: parse_arrays(read_regular(path)))


def open_regular(path: str | os.PathLike[str]) -> BinaryIO:
    """Open a regular file to read; a pipe or a device could hang or never end.

    Raises:
        ValueError: It is one.
    """
    flags = os.O_RDONLY
    if sys.platform == "win32":
        flags |= os.O_BINARY
    else:
        flags |= os.O_NONBLOCK
    file = os.fdopen(os.open(path, flags), "rb")
    kind = os.fstat(file.fileno()).st_mode
    if stat.S_ISREG(kind):
        return file
    file.close()
    if stat.S_ISDIR(kind):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), os.fspath(path))
    raise ValueError("it is not a regular file")


def read_regular(path: str | os.PathLike[str], most: int = MOST_BYTES) -> bytes:
    """Return the content of a regular file.

    Raises:
        ValueError: It is one, or larger than ``most`` bytes.
    """
    with open_regular(path) as file:
        content = file.read(most + 1)
    if len(content) > most:
        raise ValueError(f"it is larger than {most / 2**20:.0f} MiB")
    return content


def parse_json(content: bytes | str) -> dict[str, Any]:
    """Return the JSON object in ``content``."""
    text = content if isinstance(content, str) else content.decode("utf-8")
    try:
        data = json.loads(text, parse_int=_parse_int)
    except RecursionError:
        raise ValueError("it is nested too deeply") from None
    if not isinstance(data, dict):
        raise ValueError("this is not a JSON object")
    level: list[Any] = [data]
    most_depth = 64  # levels of lists and objects: what is deeper cannot be copied or written again
    for _ in range(most_depth):
        level = [
            child
            for container in level
            if isinstance(container, (dict, list))
            for child in (container.values() if isinstance(container, dict) else container)
        ]
    if level:
        raise ValueError(f"it is nested more than {most_depth} levels deep")
    if "\\u" in text:  # half of a surrogate pair cannot be written again
        json.dumps(data, ensure_ascii=False).encode()
    return data


def seal(content: Mapping[str, object]) -> dict[str, object]:
    """Return a JSON object with its checksum; wall times, keys ``seconds``, do not count."""
    return {**content, CHECKSUM: _checksum(content)}


def check_seal(path: Path, content: Mapping[str, object], hint: str) -> None:
    """Raise a ``UsageError`` if the checksum of a JSON object does not fit; without one it is as it is."""
    stored = content.get(CHECKSUM)
    if stored is not None and stored != _checksum(content):
        raise UsageError(f"{path}: it was changed after it was written: its checksum does not fit", hint)


def digest(text: str) -> str:
    """Return 16 hexadecimal digits that identify a text."""
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _checksum(content: Mapping[str, object]) -> str:
    counted = _without_seconds({key: value for key, value in content.items() if key != CHECKSUM})
    text = json.dumps(counted, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def _without_seconds(value: object) -> object:
    if isinstance(value, Mapping):
        return {key: _without_seconds(entry) for key, entry in value.items() if key != "seconds"}
    return [_without_seconds(entry) for entry in value] if isinstance(value, list | tuple) else value


def _parse_int(text: str) -> int:
    if len(text) > 20:  # characters of 64 bits
        raise ValueError(f"it holds a whole number of {len(text)} digits; at most 20 are read")
    return int(text)


def write_arrays(path: Path, arrays: Mapping[str, NDArray[Any]], compress: bool = True) -> None:
    """Write arrays as an npz file, completely or not at all; the same arrays give the same bytes."""
    import numpy as np

    content = io.BytesIO()
    save: Callable[..., None] = np.savez_compressed if compress else np.savez
    save(content, allow_pickle=False, **arrays)
    write_atomic(path, content.getvalue())


def parse_arrays(content: bytes) -> Arrays:
    """Return the arrays of an npz file: of numbers, truth values and texts."""
    import numpy as np

    if not zipfile.is_zipfile(io.BytesIO(content)):
        raise ValueError("it holds something else than arrays, or is cut short")
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            expanded = sum(member.file_size for member in archive.infolist())
        if expanded > max(_MAX_EXPANDED_BYTES, 4 * len(content)):
            raise ValueError(f"it would expand to {expanded / 2**30:.1f} GiB")
        with np.load(io.BytesIO(content), allow_pickle=False) as file:
            arrays = {str(name): np.asarray(file[name]) for name in file.files}
    except Exception as error:  # zipfile and NumPy raise many kinds of errors for a damaged file
        reason = " ".join(str(error).split())[:120] or type(error).__name__
        # NumPy's advice is to trust the file
        reason = "it holds something else than arrays" if "pickle" in reason else reason
        raise ValueError(reason) from error
    for name, array in arrays.items():
        if array.dtype.kind not in "biufU":  # truths, numbers and texts
            raise ValueError(f"{name} is of type {array.dtype}")
    return arrays


def _explain_errors(path: Path, hint: str, read: Callable[[], _Content]) -> _Content:
    try:
        return read()
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else error
        raise UsageError(f"{path}: cannot be read: {reason}", hint) from error
