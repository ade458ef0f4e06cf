"""Heat maps as tiny PNG pictures: colour for the sign, opacity for the size, so that they suit any ground."""

from __future__ import annotations

import base64
import struct
import zlib

import numpy as np
from numpy.typing import NDArray

from avrare.protocols import Floats

_POSITIVE, _NEGATIVE = (59, 111, 196), (205, 84, 55)


def signed(values: Floats, largest: Floats | float, least: float = 0.0) -> str:
    """A data URI of a picture with one pixel a value.

    Args:
        values: (rows, columns); NaN is left empty, infinities are as opaque as can be.
        largest: Size that is fully opaque: of all, or of each row (rows, 1).
        least: Opacity of the smallest value other than zero.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.clip(np.abs(values) / largest, 0.0, 1.0)
    share = np.where(np.isnan(share), np.where(np.isnan(values), 0.0, 1.0), share)
    opaque = np.where((share > 0.0) | (values < 0.0), least + (1.0 - least) * share, 0.0)
    colours = np.where((values > 0.0)[..., None], _POSITIVE, _NEGATIVE)
    pixels = np.concatenate([colours, np.round(255.0 * opaque)[..., None]], axis=-1).astype(np.uint8)
    return "data:image/png;base64," + base64.b64encode(png(pixels)).decode("ascii")


def png(pixels: NDArray[np.uint8]) -> bytes:
    """An RGBA picture (rows, columns, 4) as PNG."""
    rows, columns, _ = pixels.shape
    lines = b"".join(b"\0" + row.tobytes() for row in pixels)
    head = struct.pack(">IIBBBBB", columns, rows, 8, 6, 0, 0, 0)
    parts = ((b"IHDR", head), (b"IDAT", zlib.compress(lines, 9)), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(_chunk(kind, content) for kind, content in parts)


def _chunk(kind: bytes, content: bytes) -> bytes:
    check = zlib.crc32(kind + content)
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", check)
