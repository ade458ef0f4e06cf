"""Seeded damage to untrusted files: values of trees, pieces of texts, cells of tables, arrays and bytes."""

import copy
import io
import json
import re
import zipfile

import numpy as np

from avrare.base.stored_files import CHECKSUM, seal

DEEP = "deep"
JSON_VALUES = [
    None, {}, [], "", "x", -1, 0, 3, 1e308, -0.5, True, float("nan"), float("inf"), 10**400, "[bold red]",
    "\x1b[31mred\x1b[0m", "<script>alert(1)</script>", "\ud800", "../../up", [[]],
    {"a": 1}, "2026-99-99", DEEP,
]  # fmt: skip
WORDS = [
    "", " ", "é", "near", "a b", "../up", "/dev/null", "/etc/passwd", "a\nb", "\x07", "\x9b31m", "\u202ex",
    "[/]", "=1+1", "@x", "x" * 3000, "((", "%s", "{0}", "$HOME", "~",
    "0x1f", "٣", "evil:build", "file:///etc/passwd",
]  # fmt: skip
PIECES = [
    "\t", "\n", "  ", ": ", "- ", "{", "}", "[", "]", "&a ", "*a", "!!int ", "|", "'", '"', "#", "<<: ", "? ",
    "---\n", "1e999", ".nan", "9" * 30, "\0", "\x85", "\u2028", "\ufeff", '"\\ud800"', "\r", ",", "-", "<",
    "&k;", "</", "]]>", "%", "(", "\x1b[2J", "extends: s.yaml\n",
    '<!DOCTYPE a [<!ENTITY k SYSTEM "file:///etc/passwd">]>',
]  # fmt: skip


def damage_json(content, random, sealed=True):
    """Replace, remove or repeat one value of a JSON file; or damage its bytes. Half are ``sealed`` again."""
    if random.random() < 0.2:
        return damage_bytes(content, random)
    tree = copy.deepcopy(json.loads(content))
    places = list(_places(tree))
    parent, key = places[random.integers(len(places))]
    what = random.integers(10)
    if what == 0:
        del parent[key]
    elif what == 1 and isinstance(parent, dict):
        parent[str(random.integers(100))] = parent.pop(key)
    else:
        parent[key] = JSON_VALUES[random.integers(len(JSON_VALUES))]
    if sealed and CHECKSUM in tree and random.random() < 0.5:  # on purpose, not by accident
        tree = seal(tree)
    text = json.dumps(tree)
    return text.replace('"deep"', "[" * 900 + "]" * 900 if random.random() < 0.5 else "[" * 99_999).encode()


def _keys(tree):
    return list(tree) if isinstance(tree, dict) else range(len(tree))


def _places(tree):
    for key in _keys(tree):
        yield tree, key
        if isinstance(tree[key], (dict, list)):
            yield from _places(tree[key])


def damage_arrays(content, random):
    """Change rank, length, type or numbers of one array of an npz file, with sums that fit; or its bytes."""
    if random.random() < 0.2:
        return damage_bytes(content, random)
    with np.load(io.BytesIO(content)) as file:
        arrays = dict(file)
    names = list(arrays)
    name = names[random.integers(len(names))]
    array = arrays[name]
    flat = array.reshape(-1)
    other = names[random.integers(len(names))]
    number = array.dtype.kind in "fiu" and flat.size
    changes = [
        lambda: array[None], lambda: flat, lambda: flat[:-1], lambda: np.concatenate([flat, flat]),
        lambda: np.array(7), lambda: np.array("text"), lambda: array.astype("U8"), lambda: arrays[other],
        lambda: np.zeros(0), lambda: np.zeros((0, 5, 0)), lambda: array.astype(bool),
        lambda: array.astype(np.float32) if number else array[..., None],
        lambda: np.full_like(array, np.nan) if array.dtype.kind == "f" else array[..., None],
        lambda: array + 1 if number else np.array(["\x1b[31m"]), lambda: np.array(b"bytes"),
        lambda: np.array("[" * 99_999), lambda: np.array("{}"), lambda: np.array([object()]),
        lambda: array.astype(complex) if number else np.array("null"),
        lambda: np.full((), 2**62), lambda: np.full((), -(2**40)),
        lambda: np.zeros(3, dtype=[("a", "f8")]), lambda: _nudged(array) if number else np.array(1.5),
    ]  # fmt: skip
    if random.random() < 0.1:
        return _damage_header(arrays, name, random)
    if random.random() < 0.1:
        del arrays[name]
    else:
        arrays[name] = changes[random.integers(len(changes))]()
    changed = io.BytesIO()
    np.savez(changed, **arrays)
    return changed.getvalue()


def _damage_header(arrays, name, random):
    """Let the header of one array promise another shape or type than its bytes have."""
    changed = io.BytesIO()
    with zipfile.ZipFile(changed, "w") as archive:
        for key, array in arrays.items():
            member = io.BytesIO()
            np.save(member, array, allow_pickle=array.dtype.hasobject)
            content = member.getvalue()
            if key == name:
                content = _other_header(content, random)
            archive.writestr(f"{key}.npy", content)
    return changed.getvalue()


def _other_header(content, random):
    shapes = [
        "(1000000000000,)",
        "(-1,)",
        "(2147483648, 2147483648)",
        "(0, 99999999999)",
        "(3.5,)",
        "()",
        "(1,)",
    ]
    kinds = ["'<U2147483647'", "'|O'", "'<f8,<f8'", "'<M8[s]'", "'|V0'", "'<U0'", "[('a', '<f8')]"]
    kinds += ["'<f16'", "'>f8'"]
    end = content.index(b"\n", 10)
    header = content[10:end].decode()
    if random.random() < 0.5:
        header = re.sub(r"'shape': \([^)]*\)", f"'shape': {shapes[random.integers(len(shapes))]}", header)
    else:
        header = re.sub(r"'descr': [^,]*", f"'descr': {kinds[random.integers(len(kinds))]}", header)
    text = header.rstrip().encode()
    text += b" " * (-(len(text) + 11) % 64) + b"\n"
    return content[:8] + len(text).to_bytes(2, "little") + text + content[end + 1 :]


def _nudged(array):
    changed = array.copy()
    changed.reshape(-1)[0] += 1
    return changed


def damage_tree(tree, random):
    """Return plain data with one to three changes; in half of the cases of numbers only, to be accepted."""
    tree, gentle = copy.deepcopy(tree), random.random() < 0.5
    for _ in range(random.integers(1, 4)):
        places = [place for place in _places(tree) if not gentle or _is_number(place)]
        if not places:
            return tree
        parent, key = pick(random, places)
        value, what = parent[key], 3 if gentle else random.integers(6)
        if what == 0:
            del parent[key]
        elif what == 1 and isinstance(parent, dict):
            parent[f"{key}{pick(random, ['s', '_', ' ', '.x', 'é'])}"] = parent.pop(key)
        elif what == 2:
            container, name = pick(random, places)
            parent[key] = copy.deepcopy(container[name]) if name in _keys(container) else [value]
        elif what == 3 and _is_number((parent, key)):
            parent[key] = pick(random, [value + 1, value - 1, value * 2, value / 2, -value, value * 1e3])
        else:
            parent[key] = copy.deepcopy(pick(random, [*JSON_VALUES, *WORDS, {"plugin": value}, [value] * 3]))
    return tree


def _is_number(place):
    parent, key = place
    return type(parent[key]) in (int, float)


def damage_text(text, random, pieces=()):
    """Return a text with one to four pieces replaced, inserted or repeated."""
    for _ in range(random.integers(1, 5)):
        place = int(random.integers(len(text) + 1))
        end = place + pick(random, [0, 0, 1, 3, 20])
        copied = text[place : place + int(random.integers(1, 60))]
        text = text[:place] + pick(random, [*PIECES, *pieces, "", copied]) + text[end:]
    return text


def damage_table(text, random):
    """Return a CSV text with a cell, row or column changed."""
    rows = [line.split(",") for line in text.splitlines()]
    i, j = int(random.integers(len(rows))), int(random.integers(len(rows[0])))
    word = str(pick(random, [*WORDS, 0, -1, 1e308, 10**40, "nan", "inf", '"', "1.5.2"]))
    match random.integers(5):
        case 0:
            rows[i] = [word] * len(rows[i])
        case 1:
            rows.insert(i, list(rows[-1]))
        case 2:
            rows = [row[:j] + row[j + 1 :] for row in rows]
        case 3:
            rows[i] = rows[i][:j]
        case _:
            rows[i][j] = word
    return "\n".join(map(",".join, rows))


def pick(random, options):
    """Return one of several."""
    return options[int(random.integers(len(options)))]


def damage_bytes(content, random):
    """Flip, cut, insert or zero some bytes."""
    changed = bytearray(content)
    at = int(random.integers(len(changed)))
    match random.integers(4):
        case 0:
            changed[at] ^= 1 << int(random.integers(8))
        case 1:
            del changed[at:]
        case 2:
            changed[at:at] = random.bytes(3)
        case _:
            changed[at : at + 20] = bytes(20)
    return bytes(changed)
