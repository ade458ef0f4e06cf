"""Mutations of trees (YAML, JSON), texts and tables; those of bytes and arrays are in ``damage``."""

import copy
import re

from damage import DEEP, damage_bytes

NUMBERS = [
    0,
    1,
    -1,
    2,
    3,
    10,
    0.5,
    -0.5,
    1e-12,
    1e12,
    1e308,
    -1e308,
    5e-324,
    10**40,
    2**31,
    2**53,
    2**63,
    1e30,
]
WORDS = [
    "", " ", "x", "é", "1", "1e3", "null", "true", "near", "a b", "../up", "/dev/null", "/etc/passwd",
    "a\nb", "\t",
    "\x1b[31mred\x1b[0m", "\x07", "\x9b31m", "\u202ex", "\u2028", "[bold red]", "[/]",
    "<script>alert(1)</script>",
    "=1+1", "@x", "x" * 3000, "\ud800", "always (x < 1)", "((", "{cut_in_time}", "%s", "{0}", "$HOME", "~",
    "con",
    "checkpoint", "result.json", ".", "..", "a/b", "2026-99-99", "nan", "-inf", "0x1f", "1_000", "٣", "mc",
    "ams",
]  # fmt: skip
VALUES = [None, True, False, float("nan"), float("inf"), float("-inf"), [], {}, [[]], {"a": 1}, [1, 2], DEEP]
_PIECES = [
    "\t", "\n", "  ", ":", ": ", "- ", "{", "}", "[", "]", "&a ", "*a", "!", "!!int ", "|", ">", "'",
    '"', "#", "~",
    "1e999", ".nan", "0x", "9" * 30, "\0", "\x85", "\u2028", "\ufeff", "é", "---\n", "? ", "<<: ", "\\",
    "\x1b[2J",
    "extends: s.yaml\n", '"\\ud800"', "@", "`", "\r", ",", ";", "=", "-", "<", "&", "</", "<!--", "]]>", "%",
    "(",
]  # fmt: skip


def pick(random, options):
    """Return one of several."""
    return options[int(random.integers(len(options)))]


def places(tree):
    """Return every (container, key) in a tree of dictionaries and lists."""
    keys = list(tree) if isinstance(tree, dict) else range(len(tree)) if isinstance(tree, list) else []
    return [place for key in keys for place in [(tree, key), *places(tree[key])]]


def mutate_tree(tree, random, others=()):
    """Return a tree with one to three changes; parts of ``others`` may be put in.

    Half of the trees are changed gently, so that they are likely to be accepted and what reads them goes on.
    """
    tree, gentle = copy.deepcopy(tree), random.random() < 0.5
    for _ in range(1 + int(random.integers(3)) * int(random.integers(2))):
        found = places(tree)
        if found and gentle:
            _nudge(*pick(random, found), random)
        elif found:
            _change(*pick(random, found), random, tree if not others else pick(random, [tree, *others]))
    return tree


def _nudge(parent, key, random):
    value = parent[key]
    if isinstance(value, bool):
        parent[key] = not value
    elif isinstance(value, (int, float)):
        changes = [
            value + 1,
            value - 1,
            value * 2,
            value / 2,
            0,
            1,
            -value,
            value * 1e3,
            value * 1e-3,
            float(value),
        ]
        parent[key] = pick(random, changes[:8] if isinstance(value, int) else changes)
        if isinstance(value, int) and random.random() < 0.8:
            parent[key] = int(parent[key])
    elif isinstance(value, list) and value:
        pick(random, [value.pop, value.reverse, lambda: value.append(copy.deepcopy(value[0])), value.clear])()
    elif isinstance(value, str):
        siblings = [other for _, other in _leaves(parent) if isinstance(other, str)]
        parent[key] = pick(random, [value.upper(), f"{value} ", *siblings])
    elif isinstance(parent, dict) and random.random() < 0.5:
        del parent[key]


def _leaves(parent):
    return list(parent.items()) if isinstance(parent, dict) else list(enumerate(parent))


def _change(parent, key, random, other):
    value, what = parent[key], random.integers(12)
    if what == 0:
        del parent[key]
    elif what == 1 and isinstance(parent, dict):
        parent[pick(random, [f"{key}s", f"{key}_", *WORDS])] = parent.pop(key)
    elif what == 2 and isinstance(parent, list):
        parent[key:key] = [copy.deepcopy(value)] * int(random.integers(1, 4))
    elif what in (3, 4):
        container, name = pick(random, places(other) or [(parent, key)])
        parent[key] = copy.deepcopy(container[name])
    elif what == 5:
        parent[key] = pick(random, [[value], {"x": value}, str(value), {"plugin": value}])
    elif what == 6:
        parent[key] = pick(random, VALUES)
    elif isinstance(value, (int, float)):
        parent[key] = _mutate_number(value, random)
    elif isinstance(value, str):
        parent[key] = mutate_text(value, random) if random.random() < 0.5 else pick(random, WORDS)
    else:
        parent[key] = pick(random, [*VALUES, *NUMBERS, *WORDS])


def _mutate_number(value, random):
    changes = [-value, value + 1, value - 1, value * 10, value / 3, float(value), str(value), *NUMBERS]
    return pick(random, changes)


def mutate_text(text, random, pieces=()):
    """Return a text with one to four pieces replaced, put in or repeated."""
    for _ in range(int(random.integers(1, 5))):
        place = int(random.integers(len(text) + 1))
        end = min(len(text), place + pick(random, [0, 0, 1, 3, 20]))
        copied = text[place : place + int(random.integers(1, 60))]
        piece = pick(random, [*_PIECES, *pieces, *WORDS[:12], "", copied])
        text = text[:place] + piece + text[end:]
    return text


def mutate_table(text, random):
    """Return a CSV text with changed cells, rows or columns."""
    rows = [line.split(",") for line in text.splitlines()]
    for _ in range(int(random.integers(1, 4))):
        i = int(random.integers(len(rows)))
        j = int(random.integers(max(1, len(rows[i]))))
        match random.integers(7):
            case 0:
                rows[i] = [str(pick(random, [*NUMBERS, *WORDS, "nan", "inf", '"', "1.5.2"])) for _ in rows[i]]
            case 1:
                rows[i], rows[j % len(rows)] = rows[j % len(rows)], rows[i]
            case 2:
                rows[i:i] = [list(rows[i])] * int(random.integers(1, 3))
            case 3:
                rows = [row[:j] + row[j + 1 :] for row in rows] or [[]]
            case 4:
                rows[i] = rows[i][:j]
            case _:
                rows[i][j : j + 1] = [str(pick(random, [*NUMBERS, *WORDS, "nan", "inf", '"', "1.5.2"]))]
    return pick(random, ["\n", "\n", "\n", "\r\n"]).join(map(",".join, rows))


_BOMB = (
    '<!DOCTYPE a [<!ENTITY a "aaaaaaaaaa">'
    + "".join(f'<!ENTITY {b} "{10 * f"&{a};"}">' for a, b in zip("abcdefghij", "bcdefghijk", strict=True))
    + "]>"
)
_XML_PIECES = [
    _BOMB,
    "&k;",
    '<!DOCTYPE a [<!ENTITY k SYSTEM "file:///etc/passwd">]>',
    "<x>",
    "</obstacle>",
    'id="1"',
    "<time/>",
]


def mutate_xml(text, random) -> bytes:
    """Return an XML file with one to three values, tags or pieces changed, or with damaged bytes."""
    for _ in range(random.integers(1, 4)):
        found = list(re.finditer(r">([^<>\n]+)<|\"([^\"]*)\"|<(/?\w+)", text))
        match = pick(random, found)
        group = next(k for k in (1, 2, 3) if match[k] is not None)
        if random.random() < 0.7:
            word = str(pick(random, [0, -1, 1e308, 10**40, "nan", "inf", 0.5, 7, *WORDS[:20]]))
            text = text[: match.start(group)] + word.replace("<", "") + text[match.end(group) :]
        elif random.random() < 0.5:
            other = pick(random, found)  # of the undamaged text: a piece moves somewhere else
            low, high = sorted((match.start(), other.start()))
            text = (
                text[:low] + text[high:]
                if random.random() < 0.5
                else text[:high] + text[low:high] + text[high:]
            )
        else:
            text = mutate_text(text, random, _XML_PIECES)
    content = text.encode("utf-8", "surrogatepass")
    return damage_bytes(content, random) if random.random() < 0.1 else content
