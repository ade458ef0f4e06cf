import math

import pytest
import yaml

from avrare.base.errors import ScenarioError
from avrare.scenario.value_positions import Mark
from avrare.scenario.yaml import MAX_BYTES, dump, parse, parse_value


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1e-3", 1e-3), ("1e3", 1000.0), ("-2.5E+1", -25.0), ("7", 7), ("010", 10), ("0x1F", 31),
        (".inf", math.inf), ("true", True), ("yes", "yes"), ("1:30", "1:30"), ("2024-01-01", "2024-01-01"),
        ("1_000", "1_000"), ("", None), ("null", None), ('"1"', "1"), ("!!str 1", "1"),
        ("[1e1, a]", [10.0, "a"]), ("{a: {b: 1}}", {"a": {"b": 1}}),
    ],
)  # fmt: skip
def test_scalars_are_those_of_yaml_1_2(text, value):
    found = parse_value(text, Mark("x")).plain()
    assert found == value
    assert type(found) is type(value)


def test_every_key_and_value_has_its_place():
    tree = parse(b"a: 1\nbb:\n  - {c:   2}\n", "f.yaml")
    inner = tree.entries["bb"].child(0).entries["c"]
    assert (str(tree.entries["bb"].key), str(tree.entries["bb"].mark)) == ("f.yaml:2:1", "f.yaml:3:3")
    assert (str(inner.key), str(inner.mark)) == ("f.yaml:3:6", "f.yaml:3:11")


BOMB = b"a: &a [x,x,x,x,x,x,x,x,x]\n" + b"".join(
    b"%c: &%c [%s]\n" % (c + 1, c + 1, b",".join([b"*%c" % c] * 9)) for c in range(97, 107)
)


@pytest.mark.parametrize(
    ("data", "place", "words"),
    [
        (b"", "f:1:1", "empty"),
        (b"- a\n", "f:1:1", "mapping of keys"),
        (b"a: 1\nb: 2\na: 3\n", "f:3:1", "duplicate key 'a'"),
        (b"a:\n  b: 1\n  b: 1\n", "f:3:3", "duplicate key 'b'"),
        (b"a:\n\tb: 1\n", "f:2:1", "\\t"),
        (b"a: b: c\n", "f:1:5", "mapping values"),
        (b"1: a\n", "f:1:1", "key 1 is not a string"),
        (b"? [a]\n: b\n", "f:1:3", "must be a string"),
        (b"a: 1\n---\nb: 2\n", "f:2:1", "more than one document"),
        (b'a: "\\0"\n', "f:1:4", "NUL"),
        (b'a: "\\ud800"\n', "f:1:4", "surrogate"),
        (b"a: !!python/object:os.system x\n", "f:1:4", "python/object"),
        (b"a: !!int x\n", "f:1:4", "'!!int' is not allowed"),
        (b"a: [1, 2\n", "f:2:1", "not YAML"),
        (b"<<: {a: 1}\n", "f:1:1", "merge keys"),
        (b"a: *b\n", "f:1:4", "undefined alias"),
        (b"a: &x [*x]\n", "f:1:4", "nested"),
        (b"a: " + b"[" * 5000, "f:1:53", "nested more than 50"),
        (b"a: " + b"9" * 5000, "f:1:4", "too long"),
        (BOMB, "f:1:", "aliases expanded"),
        (b"a: " + b"x" * MAX_BYTES, "f", "too large"),
    ],
)
def test_unreadable_yaml_is_one_clear_line(data, place, words):
    with pytest.raises(ScenarioError) as caught:
        parse(data, "f")
    [(message, _)] = caught.value.problems
    assert message.startswith(place)
    assert words in message
    assert "\n" not in message
    assert int(caught.value.exit_code) == 4


def test_a_dump_reads_back_to_the_same_values():
    words = ["1e-3", "yes", "1:30", "~", "0o7", "x: y", "", "tab\t", "π"]
    data = {"a": words, "b": {"c": 1e-5, "d": math.inf}}
    assert parse(dump(data).encode(), "f").plain() == data


def test_merge_keys_are_read_as_in_yaml_1_1_where_they_are_allowed():
    text = b"a: &a {x: 1, y: 2}\nb: &b {y: 3, z: 4}\nc: {y: 5, <<: [*a, *b]}\nd: {<<: *b, w: 0}\n'<<': 1\n"
    assert parse(text, "f", merge_keys=True).plain() == yaml.safe_load(text)
    with pytest.raises(ScenarioError, match=r"f:1:1: << should be a mapping or a list of mappings"):
        parse(b"<<: 1\n", "f", merge_keys=True)
    with pytest.raises(ScenarioError, match=r"f:2:1: duplicate key '<<'"):
        parse(b"<<: {a: 1}\n<<: {b: 1}\n", "f", merge_keys=True)
