"""A failure as text, and as arrays: both readable on any machine, neither ever unpickled."""

from __future__ import annotations

import base64
import binascii
import json
import math
import re
import zlib
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrare.errors import UsageError
from avrare.failures.failure import Failure

MARK = "avrare1."
"""What a blob begins with: the format's version, and no dash, so that it is no option."""

_MOST_BYTES = 2**28
_TYPES = {"noise": "<f8", "checksums": "<u4", "values": "<f4"}
_AXES = {"noise": 2, "checksums": 1, "values": 2}
_CONTROL = {code: f"\\x{code:02x}" for code in (*range(32), *range(127, 160))}
_HINT = "copy it whole, or write it to a file and give --blob @FILE"


class Broken(ValueError):
    """The content is no failure; the message says why."""


def encode(failure: Failure) -> str:
    """The failure as one word of letters, digits, ``-`` and ``_``: a blob."""
    header, arrays = unpacked(failure)
    body = [_shuffled(_changes(arrays[name]) if name == "values" else arrays[name]) for name in _TYPES]
    head = json.dumps({**header, "shapes": {name: arrays[name].shape for name in _TYPES}}).encode()
    packed = zlib.compress(len(head).to_bytes(4, "little") + head + b"".join(body), 9)
    return MARK + base64.urlsafe_b64encode(packed).decode().rstrip("=")


def decode(text: str) -> Failure:
    """The failure that a blob holds; blanks and line breaks in it do not matter.

    Raises:
        UsageError: It is damaged, cut off or none at all.
    """
    word = re.sub(r"\s", "", text)
    if not word.startswith(MARK):
        start = f"it begins with {word[:12]!r}" if word else "it is empty"
        raise UsageError(f"this is no blob: {start}, not with {MARK!r}", _HINT)
    try:
        return _decoded(word.removeprefix(MARK))
    except Broken as error:
        raise UsageError(f"the blob is damaged: {error}", _HINT) from None


def _decoded(word: str) -> Failure:
    try:
        packed = base64.b64decode(word + "=" * (-len(word) % 4), altchars=b"-_", validate=True)
        inflater = zlib.decompressobj()
        content = inflater.decompress(packed, _MOST_BYTES)
    except (binascii.Error, zlib.error, ValueError):
        raise Broken("letters are wrong or missing") from None
    if not inflater.eof:
        raise Broken("its end is missing")
    size = int.from_bytes(content[:4], "little")
    header = read_header(content[4 : 4 + size])
    arrays, begin = {}, 4 + size
    for name, kind in _TYPES.items():
        shape = _shape(header, name)
        end = begin + math.prod(shape) * np.dtype(kind).itemsize
        if end > len(content):
            raise Broken("its end is missing")
        arrays[name], begin = _ordered(content[begin:end], kind).reshape(shape), end
    arrays["values"] = _summed(arrays["values"])
    return packed_from(header, arrays)


def unpacked(failure: Failure) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Header (plain data) and arrays of a failure."""
    header = {
        "scenario": failure.scenario,
        "specification": failure.specification,
        "parts": dict(failure.parts),
        "versions": dict(failure.versions),
        "robustness": failure.robustness.hex(),
        "columns": list(failure.columns),
    }
    arrays = {name: np.ascontiguousarray(getattr(failure, name), dtype=kind) for name, kind in _TYPES.items()}
    return header, arrays


def packed_from(header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> Failure:
    """The failure of a header and arrays that came from outside.

    Raises:
        Broken: They do not fit each other.
    """
    try:
        scenario, specification = _word(header["scenario"]), _word(header["specification"])
        parts, versions = (
            {_word(key): _word(value) for key, value in header[name].items()}
            for name in ("parts", "versions")
        )
        robustness = float.fromhex(header["robustness"])
        columns = tuple(map(_word, header["columns"]))
        noise, sums, values = (np.asarray(arrays[name]) for name in _TYPES)
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise Broken(f"its header is wrong: {error}") from None
    for name, array in (("noise", noise), ("checksums", sums), ("values", values)):
        if array.ndim != _AXES[name] or array.dtype != np.dtype(_TYPES[name]):
            raise Broken(f"{name} has shape {array.shape} and type {array.dtype}")
    if not np.isfinite(noise).all():
        raise Broken("the noise is not finite")
    rows = (0, len(noise))
    if len(sums) not in rows or len(values) not in rows or values.shape[1] != len(columns):
        raise Broken("its parts do not fit each other")
    noise, sums, values = noise.astype(np.float64), sums.astype(np.uint32), values.astype(np.float32)
    return Failure(scenario, specification, parts, versions, robustness, noise, sums, columns, values)


def read_header(content: bytes | str) -> dict[str, Any]:
    """The header of a failure that came from outside.

    Raises:
        Broken: It is no JSON object.
    """
    try:
        header = json.loads(content)
    except (ValueError, RecursionError):
        raise Broken("its header is unreadable") from None
    if not isinstance(header, dict):
        raise Broken("its header is unreadable")
    return header


def _word(value: Any) -> str:
    """Text that is shown in terminals, which must not obey it."""
    return str(value).translate(_CONTROL)


def _shape(header: Mapping[str, Any], name: str) -> tuple[int, ...]:
    shapes = header.get("shapes")
    shape = shapes.get(name) if isinstance(shapes, dict) else None
    whole = isinstance(shape, list) and all(type(size) is int and 0 <= size < 2**31 for size in shape)
    if not whole or len(shape) != _AXES[name]:  # type: ignore[arg-type]
        raise Broken(f"it does not say how large {name} is")
    return tuple(shape)  # type: ignore[arg-type]


def _changes(values: NDArray[Any]) -> NDArray[Any]:
    """Bits that change from step to step: what stands still packs to nothing."""
    bits = values.view("<u4").copy()
    bits[1:] ^= values.view("<u4")[:-1]
    return bits


def _summed(changes: NDArray[Any]) -> NDArray[Any]:
    bits = np.bitwise_xor.accumulate(np.ascontiguousarray(changes).view("<u4"), axis=0)
    return np.asarray(bits, dtype="<u4").view("<f4")


def _shuffled(array: NDArray[Any]) -> bytes:
    """First bytes first: they are alike, and pack better beside each other."""
    if not array.size:
        return b""
    return np.ascontiguousarray(array).view(np.uint8).reshape(array.size, -1).T.tobytes()


def _ordered(content: bytes, kind: str) -> NDArray[Any]:
    size = np.dtype(kind).itemsize
    return np.frombuffer(content, np.uint8).reshape(size, -1).T.copy().view(kind).reshape(-1)
