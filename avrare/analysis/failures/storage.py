"""Storage of failures: text blobs, and a folder with one ``.npz`` file for each; nothing is unpickled."""

from __future__ import annotations

import base64
import binascii
import io
import json
import math
import os
import re
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrare.analysis.failures.failure import Failure
from avrare.base.atomic_files import explain_file_errors, write_atomic
from avrare.base.errors import UsageError
from avrare.base.stored_files import parse_json, read_arrays
from avrare.base.visible_text import spell_line

PREFIX = "avrare1."
"""Start of every blob: the format version, without a dash so that no parser takes it for an option."""

_DTYPES = {"noise": "<f8", "checksums": "<u4", "values": "<f4"}
_AXES = {"noise": 2, "checksums": 1, "values": 2}
_ID = re.compile(r"[0-9a-f]{1,8}")


def encode(failure: Failure) -> str:
    """Return a failure as a blob: one word of letters, digits, ``-`` and ``_``."""
    header, arrays = _to_arrays(failure)
    body = [_shuffle_bytes(_xor_rows(arrays[name]) if name == "values" else arrays[name]) for name in _DTYPES]
    head = json.dumps({**header, "shapes": {name: arrays[name].shape for name in _DTYPES}}).encode()
    packed = zlib.compress(len(head).to_bytes(4, "little") + head + b"".join(body), 9)
    return PREFIX + base64.urlsafe_b64encode(packed).decode().rstrip("=")


def decode(text: str) -> Failure:
    """Return the failure of a blob; UsageError if it is damaged. Whitespace in it is ignored."""
    word = re.sub(r"\s", "", text)
    hint = "copy all of it, or write it to a file and give --blob @FILE"
    if not word.startswith(PREFIX):
        start = f"it starts with {word[:12]!r}" if word else "it is empty"
        raise UsageError(f"not a failure blob: {start}, not with {PREFIX!r}", hint)
    try:
        return _decode(word.removeprefix(PREFIX))
    except _CorruptFailureError as error:
        raise UsageError(f"the blob is damaged: {error}", hint) from None


class FailureDatabase:
    """Folder of failures, each in a file named by its id; created when the first one is added."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def ids(self) -> list[str]:
        """Return the ids of all failures, sorted."""
        stems = (path.stem for path in self.folder.glob("*.npz"))
        return sorted(stem for stem in stems if len(stem) == 8 and _ID.fullmatch(stem))

    def ensure_writable(self) -> None:
        """Raise a UsageError if failures could not be added, without creating anything."""
        place = next(path for path in (self.folder, *self.folder.absolute().parents) if path.exists())
        if not place.is_dir() or not os.access(place, os.W_OK | os.X_OK):
            text = f"{self.folder}: {place} is not a writable folder"
            raise UsageError(text, "choose another folder for failures")

    def add(self, failure: Failure) -> bool:
        """Store a failure; return False if it was stored before."""
        path = self.folder / f"{failure.id}.npz"
        if path.exists():
            return False
        header, arrays = _to_arrays(failure)
        content = io.BytesIO()
        save: Callable[..., None] = np.savez_compressed
        save(content, header=np.array(json.dumps(header)), **arrays)
        with explain_file_errors(f"{self.folder}: cannot write", "choose another folder for failures"):
            self.folder.mkdir(parents=True, exist_ok=True)
            write_atomic(path, content.getvalue())
        return True

    def load(self, prefix: str) -> Failure:
        """Return the failure whose id starts with ``prefix``; UsageError unless there is exactly one."""
        ids = self.ids()
        matches = [id_ for id_ in ids if id_.startswith(prefix)] if _ID.fullmatch(prefix) else []
        if not matches:
            hint = f"stored: {', '.join(ids[:8])}{', ...' if len(ids) > 8 else ''}"
            if not ids:
                hint = "it is empty; `avrare run --failures DIR` fills it"
            raise UsageError(f"{self.folder}: unknown failure {prefix!r}", hint)
        if len(matches) > 1:
            raise UsageError(
                f"{self.folder}: {prefix!r} is ambiguous", f"it could be {', '.join(matches[:8])}"
            )
        return self._read(self.folder / f"{matches[0]}.npz")

    def load_all(self, scenario: str | None = None) -> tuple[list[Failure], list[str]]:
        """Return all failures by id, or those of one scenario, and a message for each damaged file.

        They come without their signals, which take more memory than the noise.
        """
        failures, messages = [], []
        for name in self.ids():
            try:
                failure = self._read(self.folder / f"{name}.npz")
            except UsageError as error:
                messages.append(error.message)
                continue
            if scenario is None or failure.scenario == scenario:
                failures.append(failure.without_signals())
        return failures, messages

    def _read(self, path: Path) -> Failure:
        arrays = read_arrays(path, "remove the file")
        try:
            failure = _from_arrays(_read_header(str(arrays.pop("header", ""))), arrays)
        except _CorruptFailureError as error:
            raise UsageError(f"{path}: damaged: {error}", "remove the file") from None
        if failure.id != path.stem:
            text = f"{path}: damaged: it holds failure {failure.id}"
            raise UsageError(text, "restore the name of the file, or remove it")
        return failure


class _CorruptFailureError(ValueError):
    pass


def _decode(word: str) -> Failure:
    try:
        packed = base64.b64decode(word + "=" * (-len(word) % 4), altchars=b"-_", validate=True)
        inflater = zlib.decompressobj()
        content = inflater.decompress(packed, 2**28)
    except (binascii.Error, zlib.error, ValueError):
        raise _CorruptFailureError("characters are wrong or missing") from None
    if not inflater.eof:
        raise _CorruptFailureError("it is truncated")
    size = int.from_bytes(content[:4], "little")
    header = _read_header(content[4 : 4 + size])
    arrays, begin = {}, 4 + size
    for name, dtype in _DTYPES.items():
        shape = _read_shape(header, name)
        end = begin + math.prod(shape) * np.dtype(dtype).itemsize
        if end > len(content):
            raise _CorruptFailureError("it is truncated")
        arrays[name], begin = _unshuffle_bytes(content[begin:end], dtype).reshape(shape), end
    arrays["values"] = _undo_xor_rows(arrays["values"])
    return _from_arrays(header, arrays)


def _to_arrays(failure: Failure) -> tuple[dict[str, object], dict[str, NDArray[np.generic]]]:
    header: dict[str, object] = {
        "scenario": failure.scenario,
        "specification": failure.specification,
        "parts": dict(failure.parts),
        "versions": dict(failure.versions),
        "robustness": failure.robustness.hex(),
        "columns": list(failure.columns),
    }
    arrays: dict[str, NDArray[np.generic]] = {
        name: np.ascontiguousarray(getattr(failure, name), dtype=dtype) for name, dtype in _DTYPES.items()
    }
    return header, arrays


def _from_arrays(header: Mapping[str, Any], arrays: Mapping[str, NDArray[np.generic]]) -> Failure:
    try:
        scenario, specification = _escape(header["scenario"]), _escape(header["specification"])
        parts, versions = (
            {_escape(key): _escape(value) for key, value in header[name].items()}
            for name in ("parts", "versions")
        )
        robustness = float.fromhex(header["robustness"])
        columns = tuple(map(_escape, header["columns"]))
        noise, sums, values = (np.asarray(arrays[name]) for name in _DTYPES)
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise _CorruptFailureError(f"invalid header: {error}") from None
    for name, array in (("noise", noise), ("checksums", sums), ("values", values)):
        if array.ndim != _AXES[name] or array.dtype != np.dtype(_DTYPES[name]):
            raise _CorruptFailureError(f"{name} has shape {array.shape} and type {array.dtype}")
    if not np.isfinite(noise).all():
        raise _CorruptFailureError("the noise is not finite")
    rows = (0, len(noise))
    if len(sums) not in rows or len(values) not in rows or values.shape[1] != len(columns):
        raise _CorruptFailureError("noise, checksums and signals have different lengths")
    noise, sums, values = noise.astype(np.float64), sums.astype(np.uint32), values.astype(np.float32)
    return Failure(scenario, specification, parts, versions, robustness, noise, sums, columns, values)


def _read_header(content: bytes | str) -> dict[str, Any]:
    try:
        return parse_json(content)
    except ValueError as error:
        raise _CorruptFailureError(f"unreadable header: {error}") from None


def _escape(value: object) -> str:
    return spell_line(str(value))


def _read_shape(header: Mapping[str, object], name: str) -> tuple[int, ...]:
    shapes = header.get("shapes")
    shape = shapes.get(name) if isinstance(shapes, dict) else None
    sizes = shape if isinstance(shape, list) else []
    if len(sizes) != _AXES[name] or not all(type(size) is int and 0 <= size < 2**31 for size in sizes):
        raise _CorruptFailureError(f"the header has no valid shape of {name}")
    return tuple(sizes)


def _xor_rows(values: NDArray[np.generic]) -> NDArray[np.uint32]:
    bits = values.view("<u4").copy()  # constant signals become zeros, which compress to nothing
    bits[1:] ^= values.view("<u4")[:-1]
    return bits


def _undo_xor_rows(rows: NDArray[np.generic]) -> NDArray[np.generic]:
    bits = np.bitwise_xor.accumulate(np.ascontiguousarray(rows).view("<u4"), axis=0)
    return np.asarray(bits, dtype="<u4").view("<f4")


def _shuffle_bytes(array: NDArray[np.generic]) -> bytes:
    # The first bytes of all numbers, then the second bytes, and so on: this compresses better.
    return array.reshape(-1).view(np.uint8).reshape(-1, array.itemsize).T.tobytes()


def _unshuffle_bytes(content: bytes, dtype: str) -> NDArray[np.generic]:
    size = np.dtype(dtype).itemsize
    return np.frombuffer(content, np.uint8).reshape(size, -1).T.copy().view(dtype).reshape(-1)
