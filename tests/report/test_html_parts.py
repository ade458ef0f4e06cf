"""The small things that a report is made of."""

import json
import math
import struct
import zlib
from types import SimpleNamespace

import numpy as np
import pytest

import avrare
from avrare.estimation.result import Failures, Worst
from avrare.record.rollouts import Sample
from avrare.record.trace import Recording
from avrare.record.trace_score import score
from avrare.report.html import evidence, pixels
from avrare.report.html.drives import select
from avrare.report.html.estimates import _few, number
from avrare.report.html.markup import Markup, data, tag
from avrare.report.html.parts import _rows, predicates
from avrare.report.html.plot import Plot
from avrare.report.html.rollout import minus
from avrare.report.html.scales import Scale, decades, linear


def test_text_and_attributes_are_escaped_and_markup_is_not():
    found = tag("p", "a < b & c", [tag("b", "x"), None, ("y", 3)], class_="q\"'", hidden=True, id=None)
    assert found == '<p class="q&quot;&#x27;" hidden>a &lt; b &amp; c<b>x</b>y3</p>'
    assert isinstance(found, Markup)


def test_no_text_ends_a_block_of_data():
    block = data({"name": "</script><script>alert(1)"})
    assert block.count("<") == 2
    inner = block[block.index(">") + 1 : block.rindex("<")]
    assert json.loads(inner) == {"name": "</script><script>alert(1)"}
    with pytest.raises(ValueError, match="JSON"):
        data(math.nan)


@pytest.mark.parametrize(
    ("values", "ticks"),
    [
        ([0.0, 1.0], ["0", "0.2", "0.4", "0.6", "0.8", "1"]),
        ([-0.3, 0.1], ["−0.3", "−0.2", "−0.1", "0", "0.1"]),
    ],
)
def test_linear_ticks_are_round(values, ticks):
    assert [word for _, word in linear(values, margin=0.0).ticks()] == ticks


@pytest.mark.parametrize("values", [[], [math.nan], [2.0, 2.0], [1e300, 1e300], [0.0], [math.inf, 1.0]])
def test_any_values_have_an_axis(values):
    scale = linear(values)
    assert scale.low < scale.high
    assert scale.ticks()
    assert 0.0 <= scale.at(scale.low) < scale.at(scale.high) <= 100.0


def test_decades_hold_what_they_show_and_pass_no_end():
    scale = decades([3e-5, 0.2], 1.0)
    assert (scale.low, scale.high) == pytest.approx((1e-5, 1.0))
    assert [word for _, word in scale.ticks()] == ["10⁻⁵", "10⁻⁴", "10⁻³", "10⁻²", "0.1", "1"]
    assert scale.at(1e-5) == 0.0
    assert scale.at(0.0) == 0.0
    assert decades([], 1.0).low < decades([], 1.0).high


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
    assert np.array_equal(unpacked(pixels.png(given)), given)


def test_colour_is_the_sign_and_opacity_the_size():
    import base64

    values = np.array([[-2.0, -1.0, 0.0, 1.0, 9.0, np.nan, -np.inf]])
    uri = pixels.signed(values, 2.0, 0.2)
    (row,) = unpacked(base64.b64decode(uri.partition(",")[2]))
    assert row[:, 3].tolist() == [255, 153, 0, 153, 255, 0, 255]
    assert row[0, 0] > row[0, 2]
    assert row[3, 2] > row[3, 0]


def test_lines_break_where_there_is_no_number():
    plot = Plot(Scale(0.0, 3.0), Scale(0.0, 1.0), "t")
    plot.line(np.arange(4), np.array([0.0, 1.0, np.nan, 0.5]))
    html = plot.render()
    assert 'd="M0 100L33.33 0M100 50"' in html


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (0.0, "0"),
        (1.0, "1"),
        (0.01234, "0.0123"),
        (3.44e-5, "3.4 × 10⁻⁵"),
        (None, "–"),
        (1e-12, "1.0 × 10⁻¹²"),
    ],
)
def test_numbers_as_people_write_them(value, words):
    assert number(value) == words


def test_hyphens_in_names_are_no_minus():
    assert minus("a-b cut-in -0.5 (-3) x-1 1e-5") == "a-b cut-in −0.5 (−3) x-1 1e-5"


def test_the_most_likely_failure_has_the_shortest_noise():
    noise = np.zeros((3, 4, 2))
    noise[:, 0, 0] = [3.0, 1.0, 2.0]
    found = select("r", Failures(noise, np.array([-1.0, -0.1, -5.0]), 3), None)
    assert [(one.title, one.robustness, one.norm) for one in found] == [
        ("Worst failure", -5.0, 2.0),
        ("Most likely failure", -0.1, 1.0),
    ]
    one = select("r", Failures(noise[:1], np.array([-1.0]), 1), None)
    assert [shown.title for shown in one] == ["Worst and most likely failure"]
    near = select("r", None, Sample(np.zeros(2, np.float32), Worst(noise[0], 0.5)))
    assert [(shown.title, shown.failed) for shown in near] == [("Nearest to a failure", False)]
    assert select("r", None, None) == []


class Spec:
    """What a formula is to a report."""

    def __init__(self, formula, names=()):
        self.formula, self.names = formula, names
        self.start, self.update = formula.monitor().start, formula.monitor().update


def test_predicates_are_those_of_the_formula():
    t = np.arange(5.0)
    recording = Recording("r", 1.0, 0.0, {"x": t, "y": -t})
    spec = Spec(avrare.stl("always (x < 3 and not (y > -1))"))
    found = predicates(spec, score("r", spec, recording))
    assert [part.text for part in found] == ["x < 3", "y > -1"]
    assert np.array_equal(found[0].values, 3.0 - t)
    assert np.array_equal(found[1].values, 1.0 - t)


def test_a_predicate_speaks_of_the_vehicle_that_decides():
    near = np.array([[5.0, 9.0], [4.0, 9.0], [1.0, 9.0]])
    recording = Recording("r", 1.0, 0.0, {"near(others)": near}, names=("van", "bus"))
    spec = Spec(avrare.stl("forall o in others: always (near(o) > 2)"), ("van", "bus"))
    scored = score("r", spec, recording)
    assert scored.broken
    (part,) = predicates(spec, scored)
    assert part.text == "near(van) > 2"
    assert np.array_equal(part.values, near[:, 0] - 2.0)


def test_the_share_that_survives_is_that_of_the_particles():
    found = evidence._shares({"full_rollouts": 100, "roots": [3, 4], "discarded": [[5, 10], [25]]})
    assert found == [[0.9, 0.8], [0.5]]
    assert evidence._shares({"shares": [[0.1]], "levels": [[1.0]]}) == [[0.1]]
    assert evidence.levels({}, float, "") is None


@pytest.mark.parametrize("found", ["low", 3.0, [1.0, 2.0], {"a": 1}, [["x"]], [[[1.0]]], [[]]])
def test_levels_of_another_kind_are_not_drawn(found):
    assert evidence.levels({"levels": found, "shares": [[0.5]]}, float, "") is None
    assert evidence.levels({"levels": [[1.0]], "shares": found}, float, "") is None or found == [[]]
    assert evidence.levels({"levels": [[1.0, None]], "shares": [[0.5, None]]}, float, "") is not None


def test_one_of_so_many():
    words = {12.3: "12", 1234.0: "1,200", 3.44e6: "3.4 million", 1.23e8: "120 million", 9.99e8: "1.0 × 10⁹"}
    assert {value: _few(value) for value in words} == words


def test_zero_is_an_edge_of_the_histogram():
    edges = evidence._edges(np.array([-0.3, 1.1, 2.0]))
    assert 0.0 in edges
    assert edges[0] <= -0.3
    assert edges[-1] >= 2.0
    assert evidence.histogram(np.array([np.nan, np.inf]), False) is None


def test_convergence_is_left_out_where_failures_cannot_be_told():
    entry = {"estimator": "mc", "failures": 5, "rollouts": 4, "confidence": 0.95}
    assert evidence.convergence(entry, np.array([-1.0, 1.0, 1.0, 1.0])) is None
    found = evidence.convergence({**entry, "failures": 1}, np.array([-1.0, 1.0, 1.0, 1.0]))
    assert "ending at 0.25" in found


def test_a_vehicle_may_be_called_like_a_variable():
    quantifiers = [SimpleNamespace(variable="a"), SimpleNamespace(variable="b")]
    rows = _rows("near(a, b) > gap_a", np.zeros((3, 2, 2)), quantifiers, ("b", "c"), {"a": "b", "b": "c"})
    assert [words for words, _ in rows] == ["near(b, c) > gap_a"]
