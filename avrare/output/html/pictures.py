"""Charts, strips and pictures from above as SVG paths and PNG pixels."""

from __future__ import annotations

import base64
import struct
import zlib
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from avrare.base.chart import Chart, Layer, Points

_POSITIVE, _NEGATIVE = (59, 111, 196), (205, 84, 55)


def draw_path(chart: Chart, layer: Layer) -> str:
    """Return the path of a layer other than bars, in percent of the chart."""
    if layer.kind == "level":
        return f"M0 {format_number(100.0 - chart.y.at(layer.pieces[0][0][1]))}H100"
    if layer.kind == "moment":
        return f"M{format_number(chart.x.at(layer.pieces[0][0][0]))} 0V100"
    end = {"line": "", "area": "Z", "dots": "h0"}[layer.kind]
    return "".join(f"M{_place(chart, piece)}{end}" for piece in layer.pieces)


def _place(chart: Chart, points: Points) -> str:
    x, y = zip(*points, strict=True) if points else ((), ())
    return join_points(zip(chart.x(x).tolist(), (100.0 - chart.y(y)).tolist(), strict=True))


def place_bars(chart: Chart, layer: Layer) -> list[tuple[str, str, str, str]]:
    """Return x, width, y and height of bars in percent of the chart; the least one is visible."""
    base = 100.0 - chart.y.at(0.0)
    bars = []
    for (low, _), (high, height) in layer.pieces:
        left, right = chart.x([low, high]).tolist()
        top = format_number(min(100.0 - float(chart.y(height)), base - 0.8))
        width = format_number(max(right - left - 0.25, 0.3))
        bars.append((format_number(left), width, top, format_number(base - float(top))))
    return bars


def join_points(points: Iterable[tuple[float, float]]) -> str:
    """Return points as the middle of a path."""
    return "L".join(f"{format_number(x)} {format_number(y)}" for x, y in points)


def format_number(value: float) -> str:
    """Return a length with at most two decimals."""
    return f"{value:.2f}".rstrip("0").rstrip(".")


def encode_strip(shares: tuple[tuple[float, ...], ...], least: float) -> str:
    """Return the data URI of a strip: colour for the sign, opacity for the size of a share.

    Zero is transparent; the smallest other share has the opacity ``least``.
    """
    signed = np.array(shares, dtype=np.float64)
    opacity = np.where(signed != 0.0, least + (1.0 - least) * np.abs(signed), 0.0)
    colours = np.where((signed > 0.0)[..., None], _POSITIVE, _NEGATIVE)
    pixels = np.concatenate([colours, np.round(255.0 * opacity)[..., None]], axis=-1).astype(np.uint8)
    return "data:image/png;base64," + base64.b64encode(encode_png(pixels)).decode("ascii")


def encode_png(pixels: NDArray[np.uint8]) -> bytes:
    """Encode an RGBA picture (rows, columns, 4) as PNG."""
    rows, columns, _ = pixels.shape
    lines = b"".join(b"\0" + row.tobytes() for row in pixels)
    head = struct.pack(">IIBBBBB", columns, rows, 8, 6, 0, 0, 0)
    parts = ((b"IHDR", head), (b"IDAT", zlib.compress(lines, 9)), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))
        for kind, content in parts
    )
