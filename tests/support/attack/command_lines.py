"""Command lines: each command with options of its own, missing and repeated ones, and odd values."""

from attack.mutation import WORDS, mutate_text, pick
from avrare.cli.main import COMMANDS, PROVIDED
from avrare.cli.options import OPTIONS

_LONG = {"new", "pem", "flow", "synthesise", "compare"}
"""Commands that compute for seconds, or write packages."""
_VALUES = {
    "SCENARIO": ["walk.yaml", "walk.yaml", "none.yaml", "run", "run/scenario.yaml", "drive.csv"],
    "DIR": ["run", "out", "baselines", "failures", "walk.yaml", "none/deeper", "/dev/null"],
    "FILE": [
        "drive.csv",
        "signals.csv",
        "walk.yaml",
        "run",
        "out.txt",
        "run/result.json",
        "none/deeper/x",
        "/dev/full",
    ],
    "KIND=N": [
        "rollouts=20",
        "steps=500",
        "seconds=0.1",
        "rollouts=0",
        "rollouts",
        "bananas=1",
        "steps=nan",
        "rollouts=1e99",
    ],
    "KEY=VALUE": [
        "seed=1",
        "steps=3",
        "estimator.rollouts=20",
        "rule=R_G1",
        "cut_in_time=1",
        "x",
        "=",
        "steps=",
        "a.b.c=1",
    ],
    "N": ["1", "2", "0", "-1", "1.5", "x", "9" * 30],
    "NAME": ["near", "far", "R_G1", "walk", "mc", "ams", "serial", "toy_walk", "none", "ego"],
    "FORMULA": ["always (gap > 2)", "p", "((", ""],
    "Y,...": ["-1.75,1.75,5.25", "1", "", "a,b", "1,1", "nan"],
    "I,...": ["0", "1,2", "9", "x"],
    "TEXT": ["@walk.yaml", "@none", "@-", "avrare1", ""],
    "ID": ["0", "1", "00000000", "-1", "../x"],
}
_STOPS = {"new": "../x y", "compare": "none.yaml"}


def words(random):
    """Return the words after ``avrare``."""
    if random.random() < 0.03:
        return [pick(random, [*WORDS, "--version", "-h", "--help", "--nothing", "-x", "valdate"])]
    command = pick(random, [*OPTIONS, *PROVIDED])
    name = command.split()[0]
    options = dict(_flat(OPTIONS.get(command, {})))
    if name in PROVIDED:
        options = {
            "--out DIR": None,
            "--seed N": None,
            "action NAME": None,
            "samples FILE": None,
            "--steps N": None,
        }
    found = command.split()
    for usage in options:
        word, _, metavar = usage.partition(" ")
        positional = not word.startswith("-")
        if random.random() > (0.9 if positional else 0.2):
            continue
        values = [_value(random, metavar or "NAME")] if metavar or positional else []
        found += values if positional else [word, *values]
    if name == "run" and "--out" not in found and "--resume" not in found:
        found += ["--out", "out", "--no-pictures"]
    if name in ("run", "check"):
        found += ["--set", "estimator.rollouts=20"]
    if name in _LONG and name in _STOPS:
        found.append(_STOPS[name])
    return _damage(found, random) if random.random() < 0.2 else _safe(found)


def _flat(options):
    for usage, entry in options.items():
        if isinstance(entry, dict):
            yield from _flat(entry)
        else:
            yield usage, entry


def _value(random, metavar):
    return (
        str(pick(random, _VALUES.get(metavar, ["x", *_VALUES["FILE"]])))
        if random.random() < 0.85
        else pick(random, WORDS)
    )


def _damage(found, random):
    i = 1 + int(random.integers(max(1, len(found) - 1)))
    match random.integers(4):
        case 0:
            found = found[:i]
        case 1:
            found = [
                *found[:i],
                pick(random, ["--", "-", "--nothing", "--seed", "-q", "--json=1", "--set"]),
                *found[i:],
            ]
        case 2:
            found = [*found, *found[1:]]
        case _ if i < len(found):
            found = [*found[:i], mutate_text(found[i], random), *found[i + 1 :]]
        case _:
            pass
    return _safe(found)


def _safe(found):
    """No cluster and no browser is started, and nothing is written outside the folder or into the root."""
    plain = [word for word in found if word not in ("--open", "ray") and not word.startswith("ray,")]
    return [
        word if not word.startswith(("/", "~", "$")) or word in ("/dev/null", "/dev/full") else "x"
        for word in plain
    ]


assert set(_LONG) <= {*COMMANDS, *PROVIDED}
