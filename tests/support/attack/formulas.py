"""Formulas: grown from the grammar, or texts of this project with their tokens changed."""

import functools
import json
import re

import yaml

from attack.material import ROOT
from attack.mutation import mutate_text, pick

_NAMES = ["gap", "speed", "p", "time", "x", "ego_x", "é", "G", "F", "s", "inf", "always"]
_RELATIONS = ["in_front_of", "distance", "keeps_safe_distance", "in_same_lane", "cut_in", "nothing"]
_NUMBERS = ["0", "1", "2.5", "-3", "1e9", "1e308", "1e-320", "9" * 40, "0.1", ".5", "1_0", "0x1"]
_BOUNDS = [
    "",
    "",
    "[0,1s]",
    "[0:3]",
    "[0,2 samples]",
    "[1,inf]",
    "[3,1]",
    "[0,0.05s]",
    "[0,1e9]",
    "[0,100ms]",
    "[-1,1]",
]
_UNARY = [
    "not",
    "always",
    "eventually",
    "historically",
    "once",
    "next",
    "s_next",
    "prev",
    "s_prev",
    "[]",
    "<>",
    "!",
]
_BINARY = ["and", "or", "->", "<->", "xor", "until", "since", "unless", "iff", "implies", "&", "||"]
_COMPARISONS = ["<", "<=", ">", ">=", "==", "!=", "<>", "="]
_FUNCTIONS = ["abs", "sqrt", "exp", "log", "min", "max", "pow", "ln", "sin"]


@functools.cache
def corpus():
    """Return formulas of the documentation, of the rules and of other tools' test cases."""
    page = (ROOT / "docs" / "formulas.md").read_text()
    texts = re.findall(r"```stl\n(.*?)```", page, re.DOTALL) + re.findall(r"`([^`\n]{3,})`", page)
    cases = json.loads((ROOT / "tests" / "data" / "stl_cases.json").read_text())
    texts += [case["formula"] for case in (cases["cases"] if isinstance(cases, dict) else cases)]
    rules = yaml.safe_load(
        (ROOT / "plugins/avrare-traffic-rules/src/avrare_traffic_rules/rules.yaml").read_text()
    )
    return texts + [rule["formula"] for rule in rules["rules"].values()]


@functools.cache
def _tokens():
    return sorted({token for text in corpus() for token in re.findall(r"\w+|[^\w\s]|\s+", text)})


def formula(random, vehicles):
    """Return a formula, mostly one with a mistake; ``vehicles``: relations between them are known."""
    what = random.random()
    if what < 0.5:
        text = _grown(random, int(random.integers(1, 7)), vehicles)
        return damage_formula(text, random) if random.random() < 0.3 else text
    if what < 0.95:
        return damage_formula(pick(random, corpus()), random)
    return _nested(random)


def damage_formula(text, random):
    """Return a formula with tokens swapped, repeated, dropped or replaced."""
    if random.random() < 0.3:
        return mutate_text(text, random, _BINARY + _UNARY + _BOUNDS)
    tokens = re.findall(r"\w+|[^\w\s]|\s+", text) or [""]
    for _ in range(int(random.integers(1, 4))):
        i, j = (int(k) for k in random.integers(len(tokens), size=2))
        change = random.integers(5)
        if change == 0:
            tokens[i], tokens[j] = tokens[j], tokens[i]
        elif change == 1 and len(tokens) > 1:
            del tokens[i]
        elif change == 2:
            tokens[i:i] = tokens[min(i, j) : min(i, j) + 12]
        else:
            tokens[i] = pick(
                random, [pick(random, _tokens()), pick(random, _NUMBERS), pick(random, _NAMES), *_BOUNDS[2:]]
            )
    return "".join(tokens)


def _grown(random, depth, vehicles):
    if depth == 0:
        return f"{_term(random, 2, vehicles)} {pick(random, _COMPARISONS)} {_term(random, 2, vehicles)}"
    below, bounds = _grown(random, depth - 1, vehicles), pick(random, _BOUNDS)
    match random.integers(5 if vehicles else 4):
        case 0:
            return f"({below}) {pick(random, _BINARY)} {bounds} ({_grown(random, depth - 1, vehicles)})"
        case 1:
            return f"rise({below})"
        case 4:
            quantifier = pick(random, ["forall", "exists", "at_least 2", "at_least 0", "at_least 99"])
            return f"{quantifier} o in {pick(random, ['others', 'others', 'ego', 'x'])}: {below}"
        case _:
            return f"{pick(random, _UNARY)} {bounds} ({below})"


def _term(random, depth, vehicles):
    if vehicles and random.random() < 0.5:
        first, second = pick(random, ["ego", "o", "van"]), pick(random, ["ego", "o", "truck"])
        return f"{pick(random, _RELATIONS)}({first}, {second})"
    if depth == 0 or random.random() < 0.4:
        return pick(random, _NAMES[:6] + _NUMBERS)
    below = _term(random, depth - 1, vehicles)
    if random.random() < 0.4:
        return f"{pick(random, _FUNCTIONS)}({below})"
    return f"({below} {pick(random, ['+', '-', '*', '/'])} {_term(random, depth - 1, vehicles)})"


def _nested(random):
    """Deep, long or doubling texts: they must be refused or computed soon."""
    many = int(pick(random, [10, 100, 1000, 20_000]))
    doubling = "\n".join(f"d{i + 1} = d{i} and d{i}" for i in range(min(many, 60)))
    texts = [
        "(" * many + "p" + ")" * many, "not " * many + "p", "always " * many + "p",
        " and ".join(["p > 0"] * many),
        "p -> " * many + "p", f"d0 = p > 0\n{doubling}\nd{min(many, 60)}", "p until " * many + "p",
        "always[0,1s] eventually[0,1s] " * (many // 2) + "p",
        "p > " + " + ".join(["speed"] * many), "[" * many,
        "abs(" * many + "p" + ")" * many, "forall o in others: " * many + "p", f"always[0,{'9' * many}s] p",
    ]  # fmt: skip
    return pick(random, texts)
