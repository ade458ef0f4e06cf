"""Heat strips: pictures and the predicates in them."""

import struct
import zlib
from types import SimpleNamespace

import numpy as np

import avrare
from avrare.analysis.monitor.monitoring import monitor_recording
from avrare.analysis.page.player import evaluate_predicates, select_rows, shade
from avrare.logic.formula import FormulaMonitor
from avrare.output.html.pictures import encode_png, encode_strip
from avrare.results.recordings import Recording


def unpacked(content):
    columns, rows = struct.unpack(">II", content[16:24])
    at, packed = 8, b""
    while at < len(content):
        (size,) = struct.unpack(">I", content[at : at + 4])
        kind, body = content[at + 4 : at + 8], content[at + 8 : at + 8 + size]
        assert struct.unpack(">I", content[at + 8 + size : at + 12 + size])[0] == zlib.crc32(kind + body)
        packed += body if kind == b"IDAT" else b""
        at += 12 + size
    lines = np.frombuffer(zlib.decompress(packed), np.uint8).reshape(rows, 1 + 4 * columns)
    return lines[:, 1:].reshape(rows, columns, 4)


def test_a_picture_holds_its_pixels():
    given = np.random.default_rng(1).integers(0, 256, (3, 5, 4)).astype(np.uint8)
    assert np.array_equal(unpacked(encode_png(given)), given)


def test_colour_is_the_sign_and_opacity_the_size():
    import base64

    values = np.array([[-2.0, -1.0, 0.0, 1.0, 9.0, np.nan, -np.inf]])
    uri = encode_strip(shade(values, 2.0), 0.2)
    (row,) = unpacked(base64.b64decode(uri.partition(",")[2]))
    assert row[:, 3].tolist() == [255, 153, 0, 153, 255, 0, 255]
    assert row[0, 0] > row[0, 2]
    assert row[3, 2] > row[3, 0]


class Spec(FormulaMonitor):
    """Formula as a report sees it."""

    def __init__(self, formula, names=()):
        super().__init__(formula)
        self.names = names


def test_predicates_are_those_of_the_formula():
    t = np.arange(5.0)
    recording = Recording("r", 1.0, 0.0, {"x": t, "y": -t})
    spec = Spec(avrare.stl("always (x < 3 and not (y > -1))"))
    found = evaluate_predicates(spec, monitor_recording("r", spec, recording))
    assert list(found) == ["x < 3", "y > -1"]
    assert np.array_equal(found["x < 3"], 3.0 - t)
    assert np.array_equal(found["y > -1"], 1.0 - t)


def test_a_predicate_is_shown_for_the_vehicle_that_decides():
    near = np.array([[5.0, 9.0], [4.0, 9.0], [1.0, 9.0]])
    recording = Recording("r", 1.0, 0.0, {"near(others)": near}, names=("van", "bus"))
    spec = Spec(avrare.stl("forall o in others: always (near(o) > 2)"), ("van", "bus"))
    scored = monitor_recording("r", spec, recording)
    assert scored.violated
    ((text, values),) = evaluate_predicates(spec, scored).items()
    assert text == "near(van) > 2"
    assert np.array_equal(values, near[:, 0] - 2.0)


def test_a_vehicle_may_have_the_name_of_a_variable():
    quantifiers = [SimpleNamespace(variable="a"), SimpleNamespace(variable="b")]
    rows = select_rows(
        "near(a, b) > gap_a", np.zeros((3, 2, 2)), quantifiers, ("b", "c"), {"a": "b", "b": "c"}
    )
    assert [words for words, _ in rows] == ["near(b, c) > gap_a"]
