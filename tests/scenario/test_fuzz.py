"""Whatever is done to a scenario file, loading it succeeds or raises an ``AvrareError``."""

import copy
import random

import pytest

from avrare.base.errors import AvrareError
from avrare.scenario.yaml import dump

PIECES = [
    "\t",
    "\n",
    "  ",
    ":",
    ": ",
    "- ",
    "{",
    "}",
    "[",
    "]",
    "&a ",
    "*a",
    "!",
    "!!int ",
    "|",
    ">",
    "'",
    '"',
    "#",
    "null",
    "~",
    "true",
    "1e999",
    ".nan",
    "-.inf",
    "0x",
    "9" * 30,
    "\0",
    "\x85",
    "\u2028",
    "\ufeff",
    "é",
    "%YAML",
    "---\n",
    "...\n",
    "? ",
    "<<: ",
    "plugin: ",
    "stl: ",
    "extends: s.yaml\n",
    "\\",
    '"\\ud800"',
    "@",
    "`",
    "\r",
    "steps: ",
    "near",
    "[]",
    "{}",
    "-1",
    "2.5",
    "estimator",
    "specifications",
    "name",
]


def mutated(text, random):
    for _ in range(random.randint(1, 4)):
        place = random.randrange(len(text) + 1)
        end = min(len(text), place + random.choice([0, 0, 1, 3, 20]))
        piece = random.choice([*PIECES, "", text[place : place + random.randint(1, 60)]])
        text = text[:place] + piece + text[end:]
    return text


def swapped(text, random):
    lines = text.splitlines(keepends=True)
    i, j = random.randrange(len(lines)), random.randrange(len(lines))
    lines[i], lines[j] = lines[j], lines[i] * random.randint(0, 2)
    return "".join(lines)


def outcome(read, *arguments):
    """Return the ``AvrareError`` of loading a scenario, None if it loads; other errors go through."""
    try:
        read(*arguments)
    except AvrareError as error:
        return error
    except Exception as error:
        raise AssertionError(f"{error!r} from {arguments!r}") from error
    return None


def is_clear(error):
    lines = error.lines()
    return bool(lines) and all(line and "\n" not in line for line in lines) and error.exit_code in (4, 5)


@pytest.mark.parametrize("seed", range(8))
def test_mutated_files_raise_scenario_errors_only(read, good, seed):
    print(f"seed {seed}")
    choose = random.Random(seed)
    errors = []
    for _ in range(60):
        text = mutated(swapped(good, choose) if choose.random() < 0.3 else good, choose)
        data = text.encode("utf-8", "surrogatepass")
        if choose.random() < 0.1:
            data = data.replace(b"a", b"\xff", 1)
        errors.append(outcome(read, data))
    assert all(is_clear(error) for error in errors if error)
    assert sum(error is not None for error in errors) > 20


@pytest.mark.parametrize("seed", range(4))
def test_mutated_overrides_raise_scenario_errors_only(read, good, seed):
    print(f"seed {seed}")
    choose = random.Random(100 + seed)
    keys = [
        "steps",
        "simulator",
        "simulator.corners.0.x",
        "thresholds.0.probability",
        "estimator",
        "",
        ".",
        "é",
    ]
    settings = [mutated(choose.choice(keys) + "=" + choose.choice(PIECES), choose) for _ in range(60)]
    errors = [outcome(read, good, [setting]) for setting in settings]
    assert all(is_clear(error) for error in errors if error)
    assert sum(error is not None for error in errors) > 20


VALUES = [
    None, True, -1, 0, 2.5, 1e30, float("inf"), float("nan"), "", "near", "1", "a\nb", [], [[]], {},
    {"plugin": "toy"}, {"plugin": None}, {"stl": "x > 1"}, {"stl": "(("},
    {"x": {"y": []}}, [{"specification": []}], 10**40,
]  # fmt: skip


def places(value):
    """Return every (container, key) inside plain data."""
    keys = list(value) if isinstance(value, dict) else range(len(value)) if isinstance(value, list) else []
    return [place for key in keys for place in [(value, key), *places(value[key])]]


def restructured(data, random):
    data = copy.deepcopy(data)
    for _ in range(random.randint(1, 3)):
        container, key = random.choice(places(data))
        action = random.choice(["replace", "replace", "remove", "add", "rename"])
        if action == "replace":
            container[key] = copy.deepcopy(random.choice(VALUES))
        elif action == "remove" and len(data) > 1:
            del container[key]
        elif isinstance(container, dict):
            value = container[key] if action == "add" else container.pop(key)
            container[str(key) + random.choice(["s", "_", " ", ".x", "é"])] = value
    return data


@pytest.mark.parametrize("seed", range(6))
def test_restructured_files_raise_scenario_errors_only(read, good, seed):
    print(f"seed {seed}")
    choose = random.Random(200 + seed)
    data = read(good).resolved
    data["simulator"]["corners"] = [{"x": 1.0}, {"x": 2.0}]
    errors = [outcome(read, dump(restructured(data, choose))) for _ in range(80)]
    assert all(is_clear(error) for error in errors if error)
    assert 20 < sum(error is not None for error in errors) < 80
