"""YAML with positions: text to nodes that know their line and column, with the plain scalars of YAML 1.2.

``1e-3`` and ``.5`` are numbers, only ``true`` and ``false`` are booleans, a date is a string. Duplicate
keys, keys that are not strings, tags and (except in rules files) merge keys are errors. Size, depth and
aliases are bounded.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence

import yaml

from avrare.scenario.value_positions import Mark, Node, Scalar

MAX_BYTES = 1_000_000
MAX_DEPTH = 50

_TAG = "tag:yaml.org,2002:"
_MERGE_KEY = "<<"
_PLAIN = (
    ("null", r"~|null|Null|NULL|"),
    ("bool", r"true|True|TRUE|false|False|FALSE"),
    ("int", r"[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+"),
    ("float", r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)"),
)
_PATTERNS = {_TAG + name: re.compile(rf"(?:{pattern})\Z") for name, pattern in _PLAIN}

_HINTS = (
    ("'\\t'", "indent with spaces, not tabs"),
    ("mapping values are not allowed", "quote a value that contains ': '"),
    ("could not find expected ':'", "write 'key: value', with a space after the colon"),
    ("expected <block end>", "check the indentation: keys of one mapping start in one column"),
    ("expected ',' or", "close the bracket that is open, or put a comma between its entries"),
    ("undefined alias", "quote a value that starts with '*'"),
    ("cannot start any token", "quote a value that starts with a special character"),
)


class _Refusal(Exception):
    def __init__(self, mark: yaml.Mark | None, text: str, hint: str | None = None) -> None:
        super().__init__(text)
        self.mark, self.text, self.hint = mark, text, hint


class _Loader(yaml.SafeLoader):
    yaml_implicit_resolvers = {None: list(_PATTERNS.items())}  # noqa: RUF012  (PyYAML's own attribute)
    depth = 0
    count = 0

    def compose_node(self, parent: yaml.Node | None, index: object) -> yaml.Node | None:
        mark = self.peek_event().start_mark  # type: ignore[no-untyped-call]
        self.depth += 1
        self.count += 1
        _check_size(mark, self.depth, self.count)
        node: yaml.Node | None = super().compose_node(parent, index)  # type: ignore[arg-type]
        self.depth -= 1
        return node


class _Dumper(yaml.SafeDumper):
    """PyYAML's dumper that quotes strings which YAML 1.1 or 1.2 would read as something else."""

    yaml_implicit_resolvers = {  # noqa: RUF012  (PyYAML's own attribute)
        **yaml.SafeDumper.yaml_implicit_resolvers,
        None: list(_PATTERNS.items()),
    }


class _Converter:
    """Converter of composed nodes, whose aliases are still shared, into a tree of marked values."""

    def __init__(self, place: Callable[[yaml.Mark | None], Mark], merge_keys: bool) -> None:
        self.place, self.merge_keys = place, merge_keys
        self.count = 0

    def convert(self, node: yaml.Node, key: Mark | None = None, depth: int = 1) -> Node:
        self.count += 1
        _check_size(node.start_mark, depth, self.count)
        mark = self.place(node.start_mark)
        if isinstance(node, yaml.MappingNode) and node.tag == _TAG + "map":
            return Node(self._mapping(node, depth), mark, key)
        if isinstance(node, yaml.SequenceNode) and node.tag == _TAG + "seq":
            return Node([self.convert(child, None, depth + 1) for child in node.value], mark, key)
        if isinstance(node, yaml.ScalarNode):
            return Node(_scalar(node), mark, key)
        raise _Refusal(node.start_mark, f"the tag {_short(node.tag)} is not allowed", "remove the tag")

    def _mapping(self, node: yaml.MappingNode, depth: int) -> dict[str, Node]:
        entries: dict[str, Node] = {}
        merged: yaml.Mark | None = None
        for key_node, value_node in node.value:
            key, start = _key(key_node), key_node.start_mark
            if key in entries:
                hint = f"it is already set at {entries[key].name_mark}; keep one of them"
                raise _Refusal(start, f"duplicate key {key!r}", hint)
            entries[key] = self.convert(value_node, self.place(start), depth + 1)
            if key == _MERGE_KEY and key_node.style is None:
                merged = start
        return entries if merged is None else self._merge(entries, merged)

    def _merge(self, entries: dict[str, Node], mark: yaml.Mark) -> dict[str, Node]:
        if not self.merge_keys:
            text = f"merge keys ({_MERGE_KEY}) are not supported"
            raise _Refusal(mark, text, "use 'extends', or repeat the keys")
        value = entries.pop(_MERGE_KEY)
        parents = value.value if isinstance(value.value, list) else [value]
        if not all(isinstance(parent.value, dict) for parent in parents):
            raise _Refusal(mark, f"{_MERGE_KEY} should be a mapping or a list of mappings")
        inherited: dict[str, Node] = {}
        for parent in reversed(parents):  # the first parent takes precedence
            inherited |= parent.entries
        return inherited | entries


def _check_size(mark: yaml.Mark | None, depth: int, count: int) -> None:
    if depth > MAX_DEPTH:
        raise _Refusal(mark, f"nested more than {MAX_DEPTH} deep")
    most_values = 20_000
    if count > most_values:
        raise _Refusal(mark, f"more than {most_values} values, aliases expanded", "use fewer aliases")


def _key(node: yaml.Node) -> str:
    if not isinstance(node, yaml.ScalarNode):
        raise _Refusal(node.start_mark, "a key must be a string, not a list or a mapping")
    value = _scalar(node)
    if not isinstance(value, str):
        raise _Refusal(node.start_mark, f"the key {node.value} is not a string", f'quote it: "{node.value}"')
    return value


def _scalar(node: yaml.ScalarNode) -> Scalar:
    text: str = node.value
    if re.search("[\0\ud800-\udfff]", text):
        raise _Refusal(node.start_mark, "a string must not contain NUL or half a surrogate pair")
    if node.tag == _TAG + "str":
        return text
    pattern = _PATTERNS.get(node.tag)
    if pattern is None or not pattern.match(text):
        raise _Refusal(node.start_mark, f"the tag {_short(node.tag)} is not allowed here", "remove the tag")
    if node.tag == _TAG + "int":
        return _integer(node)
    if node.tag == _TAG + "float":
        return float(re.sub(r"\.(?=inf|nan)", "", text.lower()))
    return None if node.tag == _TAG + "null" else text.lower() == "true"


def _short(tag: str) -> str:
    return repr(tag.replace(_TAG, "!!"))


def _integer(node: yaml.ScalarNode) -> int:
    text: str = node.value
    if len(text) > 400:
        raise _Refusal(node.start_mark, f"a number of {len(text)} digits is too long")
    return int(text, {"0o": 8, "0x": 16}.get(text[:2], 10))


def parse(
    data: bytes,
    file: str,
    content: str = "scenario",
    hint: str = "a scenario needs name, steps, simulator, specifications",
    merge_keys: bool = False,
) -> Node:
    """Parse a UTF-8 file that holds a single mapping with string keys.

    ``file`` is the path as the user wrote it, ``content`` the kind of the file, and ``hint`` that of an empty
    file.
    """
    if len(data) > MAX_BYTES:
        raise Mark(file).error(f"larger than {MAX_BYTES:,} bytes, too large for a {content}")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        before = data[: error.start]
        mark = Mark(file, before.count(b"\n") + 1, error.start - before.rfind(b"\n"))
        raise mark.error("not UTF-8 text", "save the file in UTF-8") from None
    node = _read(text, lambda mark: _place(file, mark), merge_keys)
    if node is None:
        raise Mark(file, 1, 1).error("the file is empty", hint)
    if not isinstance(node.value, dict):
        raise node.mark.error(f"a {content} is a mapping of keys to values", "write 'key: value' lines")
    return node


def parse_value(text: str, mark: Mark) -> Node:
    """Parse a single value, as after ``--set KEY=``; every part of it is placed at ``mark``."""
    node = _read(text, lambda _: mark)
    return Node(None, mark, mark) if node is None else Node(node.value, mark, mark)


def dump_list(values: Sequence[object]) -> str:
    """Return a list of plain data as YAML in one line, as after ``--set KEY=``."""
    return yaml.dump(list(values), Dumper=_Dumper, default_flow_style=True, width=math.inf).strip()


def dump(data: Mapping[str, object]) -> str:
    """Return plain data as YAML text that ``parse`` reads back to the same values."""
    return yaml.dump(dict(data), Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=100)


def _place(file: str, mark: yaml.Mark | None) -> Mark:
    return Mark(file, mark.line + 1, mark.column + 1) if mark else Mark(file, 1, 1)


def _read(text: str, place: Callable[[yaml.Mark | None], Mark], merge_keys: bool = False) -> Node | None:
    try:
        node = _Loader(text).get_single_node()
        return None if node is None else _Converter(place, merge_keys).convert(node)
    except _Refusal as problem:
        raise place(problem.mark).error(problem.text, problem.hint) from None
    except yaml.reader.ReaderError as error:
        position = int(error.position)
        before = text[:position]
        mark = yaml.Mark("", position, before.count("\n"), position - before.rfind("\n") - 1, None, 0)
        raise place(mark).error(f"the character {text[position]!r} is not allowed in YAML") from None
    except yaml.MarkedYAMLError as error:
        what, hint = _syntax(error)
        raise place(error.problem_mark or error.context_mark).error(what, hint) from None
    except (ValueError, OverflowError) as error:  # PyYAML lets chr() fail on "\U00110000"
        raise place(None).error(f"not YAML: {error}", "check the escapes in quoted strings") from None


def _syntax(error: yaml.MarkedYAMLError) -> tuple[str, str | None]:
    problem = " ".join((error.problem or "cannot be read").split())
    if "another document" in problem:
        return "more than one document", "keep one document in a file; remove the second '---'"
    begin, end = error.context_mark, error.problem_mark
    begins = f" that begins at line {begin.line + 1}" if begin and end and begin.line < end.line else ""
    context = f" ({' '.join(error.context.split())}{begins})" if error.context else ""
    hint = next((hint for sign, hint in _HINTS if sign in problem), None)
    return f"not YAML: {problem}{context}", hint
