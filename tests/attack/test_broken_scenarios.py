"""Five hundred broken scenario files: each is refused, in words, soon, with exit code 4 or 5.

Every mutation makes a file that is wrong by construction; ``SEED`` chooses where.
"""

import copy
import functools
import os
import random
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from avrare.cli.main import main
from avrare.scenario.overrides import read_extended
from avrare.scenario.yaml import dump
from untrusted_files import time_limit

SEED = 20
FILES = 500
BATCH = 25
SCENARIOS = Path(__file__).parents[2] / "scenarios"
PATHS = sorted(SCENARIOS.glob("*.yaml"))
BLOCKS = ("simulator", "perception", "tracker", "controller", "estimator")
MARKER = "executed"

WRONG = {
    "name": [None, "", "a b", "../up", "a/b", [], {}, 1.5, "é", "x" * 101, "a\nb"],
    "steps": [None, "near", -1, 2.5, [], {}, float("nan"), float("inf"), 10**40, True, "40 steps", "1e999"],
    "simulator": [None, "single_track", [], {}, {"plugin": 5}, {"plugin": ""}, {"plugin": "nothing"}, 3],
    "specifications": [None, [], {}, {"x": 1}, {"x": {}}, {"x": {"stl": 5}}, {"x y": {"stl": "x > 1"}}, "x"],
    "estimator": ["mc", [], {"plugin": "os:system"}, {"plugin": None}, {"rollouts": 5}, 1, {"plugin": "mpc"}],
    "thresholds": [5, "x", {"a": 1}, [1], [{}], [{"specification": "none_such", "probability": "< 0.1"}]],
    "seed": [-1, 2**63, "x", 1.5, [], None],
    "chunk": [0, -3, "x", {}, 10**7],
    "confidence": [0.0, 1.0, 2.0, "x", float("nan")],
    "max_error_rate": [-0.1, 1.1, "x", float("nan")],
    "suppress": ["x", ["no_such_warning"], 5],
    "regression": [1, {"ratio": -1.0}, {"ratio": 2.0, "exclude": 1.0}, {"bananas": 1}],
    "tracker": ["imm", {"plugin": "avrare.cli.main:main"}, []],
}
"""Key of a scenario -> values that it can never have."""

FORMULAS = [
    "", " ", "((", "x >", "> 1", "always[3:1] (x < 1)", "always[-1:2] (x < 1)", "x < 1 and", "until (x > 1)",
    "always[0:1 (x < 1)", "x < 1)", "(" * 5000 + "x < 1", "not " * 20000 + "(x < 1)", "x ≤ 1 ∧",
    "forall in others: x", "x <> 1", "__import__('os').system('touch executed')", "x < 1; y < 2",
    "\u202ex < 1",
    "always[0:1e999s] (", "x = = 1", "1 < x < ", "'", '"', "let a =", "#", "x.y.(z) < 1",
]  # fmt: skip

LAUGHS = "a: &a [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{b}: &{b} [{', '.join(9 * [f'*{a}'])}]\n" for a, b in zip("abcdefgh", "bcdefghi", strict=True)
)
WHOLE = [
    b"", b"\n\n", b"# nothing\n", b"null\n", b"[]\n", b"5\n", b"text\n", b"- name: x\n", b"\0", b"\xff\xfe",
    "name: x\n".encode("utf-16"), b"x" * 2_000_000, b"# " + b"y" * 1_500_000, b"a: " + b"[" * 20_000,
    b"[" * 300 + b"]" * 300, b"{a: " * 200 + b"1" + b"}" * 200, LAUGHS.encode(),
    b"steps: " + b"9" * 100_000, b"".join(b"k%d: 1\n" % k for k in range(30_000)), b"a: &a {b: *a}\n",
    b"a: &a [*a]\n", b"%YAML 9.9\n---\nname: x\n", b"---\nname: a\n---\nname: b\n", b"\xed\xa0\x80",
    b"? [a, b]\n: 1\n", b"1: 2\n", b"'': 1\n", b"name: \"\\ud800\"\n", b"name: \"\\U00110000\"\n",
]  # fmt: skip

LINES = [
    "bad: [1, 2", "bad: {a: 1", 'bad: "open', "bad: 'open", "\tbad: 1", "bad: *nothing",
    "bad: !!python/name:os.system",
    f"bad: !!python/object/apply:os.system ['touch {MARKER}']", "bad: !local 1", "bad: : :", "- bad", "bad",
    "<<: {a: 1}", "bad: @x", "bad: `x`", "bad: \x07", "bad: \u0000", "name: again\nname: again",
    "bad: %x\n\n---",
    "no_such_key: 1", "é: 1", "steps : : 2", "bad: |9z", "[a]: 1", "null: 1", "true: 1", "bad: &a &b c",
    "\u2028x: [",
]  # fmt: skip
"""A line at the top of a file with which it cannot be a scenario."""

PARENTS = [
    "/etc/passwd", "../../../../../../../../etc/passwd", "file:///etc/passwd", "http://example.org/a.yaml",
    "~/x.yaml",
    "nothing.yaml", "", ".", "_base", "../../../../../../../../dev/zero", "a\0b", "\\\\host\\a.yaml", 5,
    [], {}, True,
    "itself.yaml", "x" * 5000, "é.yaml", "_base/../nothing.yaml",
]  # fmt: skip


def unknown_key(data, choose):
    block = data.get(choose.choice(["", *BLOCKS]), data)
    block[choose.choice(["no_such_key", "Steps", "é", "stl", "rollouts_", " ", "plugin.x", "__class__"])] = 1
    return dump(data).encode()


def wrong_value(data, choose):
    key = choose.choice(sorted(WRONG))
    data[key] = choose.choice(WRONG[key])
    return dump(data).encode()


def missing_key(data, choose):
    del data[choose.choice(["name", "steps", "simulator", "specifications"])]
    return dump(data).encode()


def wrong_option(data, choose):
    """Make a number of a block a nested mapping, or take the block's plugin away."""
    block = data[choose.choice([key for key in BLOCKS if isinstance(data.get(key), dict)])]
    numbers = [key for key, value in block.items() if type(value) in (int, float)]
    if numbers:
        number = choose.choice(numbers)
        block[number] = choose.choice([{"x": {"y": []}}, [[[]]], "[m/s]", "near", float("nan")])
    else:
        del block["plugin"]
    return dump(data).encode()


def wrong_formula(data, choose):
    data["specifications"]["broken"] = {"stl": choose.choice(FORMULAS)}
    return dump(data).encode()


def wrong_parent(data, choose):
    return dump({"extends": choose.choice(PARENTS), **data}).encode()


def broken_line(data, choose):
    return (choose.choice(LINES) + "\n" + dump(data)).encode()


def broken_bytes(data, choose):
    text = dump(data).encode()
    place = choose.randrange(len(text))
    return text[:place] + choose.choice([b"\xff", b"\0", b"\xc3(", b"\x1b", b"\xed\xa0\x80"]) + text[place:]


def twice(data, choose):
    text = dump(data)
    return (text + choose.choice(["", "---\n"]) + text).encode()


def whole_file(data, choose):
    return choose.choice(WHOLE)


MUTATIONS = [
    unknown_key, missing_key, wrong_option, wrong_parent, broken_bytes, twice, whole_file,
    *3 * [wrong_value], *2 * [wrong_formula], *2 * [broken_line],
]  # fmt: skip


def merged(path):
    """Return a scenario as plain data, with everything that it extends."""
    return copy.deepcopy(_plain(str(path)))


@functools.cache
def _plain(path):
    return read_extended(path).plain()


def malformed(number):
    """Return (what was done, content) of file ``number``; the same for the same ``SEED``."""
    choose = random.Random(SEED * 10_000 + number)
    path, mutation = PATHS[number % len(PATHS)], MUTATIONS[number // len(PATHS) % len(MUTATIONS)]
    return f"seed {SEED}, file {number}: {mutation.__name__} of {path.name}", mutation(merged(path), choose)


def complaint(code, out, err):
    """Return what is wrong with the way in which a file was refused; None: nothing."""
    lines = err.splitlines()
    if code not in (4, 5):
        return f"exit code {code}"
    if "Traceback" in out + err or "bug in avrare" in err:
        return "a traceback"
    if not lines or ": ok" in out:
        return "no message"
    if len(lines) > 400 or max(map(len, lines)) > 6000:
        return f"{len(lines)} lines of up to {max(map(len, lines))} characters"
    return None


@pytest.fixture
def here(tmp_path, monkeypatch):
    folder = tmp_path / "scenarios"
    for place in (folder / "_base", folder / "openscenario", tmp_path / "openscenario"):
        shutil.copytree(SCENARIOS / place.name, place)
    monkeypatch.chdir(folder)
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("first", range(0, FILES, BATCH))
def test_malformed_files_are_refused(first, here, capsys):
    print(f"seed {SEED}")
    found = []
    for number in range(first, first + BATCH):
        what, content = malformed(number)
        Path("itself.yaml").write_bytes(content)
        with time_limit():
            code = main(["validate", "itself.yaml"])
        trouble = complaint(code, *capsys.readouterr())
        if trouble:
            found.append(f"{what}: {trouble}")
    assert found == []
    assert not Path(MARKER).exists(), "a scenario ran a command"


@pytest.mark.parametrize("number", [117, 340])
def test_malformed_files_in_a_separate_process(number, here):
    what, content = malformed(number)
    Path("itself.yaml").write_bytes(content)
    words = [sys.executable, "-m", "avrare", "validate", "itself.yaml"]
    done = subprocess.run(words, capture_output=True, text=True, check=False, timeout=120, env=os.environ)
    assert complaint(done.returncode, done.stdout, done.stderr) is None, (what, done.stderr)


@pytest.mark.parametrize("path", PATHS, ids=lambda path: path.stem)
def test_the_unmutated_files_are_valid(path, here):
    """Load them unchanged, or the others are refused for another reason; and with harmless changes."""
    text = dump(merged(path))
    for changed in (text, "\ufeff" + text, text.replace("\n", "\r\n"), "# é\n---\n" + text + "...\n"):
        Path("itself.yaml").write_bytes(changed.encode())
        assert main(["validate", "itself.yaml"]) == 0


def test_every_mutation_is_tried_on_every_scenario():
    kinds = {malformed(number)[0].split(": ")[1] for number in range(len(MUTATIONS) * len(PATHS))}
    assert len(kinds) == len(set(MUTATIONS)) * len(PATHS) <= FILES


@pytest.mark.parametrize(
    "plugin", ["evil", "evil:build", "evil.build", "./evil.py", "os:system", "avrare.cli.main:main"]
)
@pytest.mark.parametrize("command", [["validate", "--build"], ["run"]])
def test_only_installed_plugins_run(plugin, command, here, monkeypatch, capsys):
    (here / "evil.py").write_text(f"open({MARKER!r}, 'w')\nbuild = print\n")
    monkeypatch.syspath_prepend(str(here))
    content = {"name": "x", "steps": 1, "specifications": {"a": {"stl": "x < 1"}}}
    (here / "s.yaml").write_text(dump(content | {"simulator": {"plugin": plugin}}))
    assert main([*command, "s.yaml"]) == 5
    assert "unknown simulator" in capsys.readouterr().err
    assert "evil" not in sys.modules
    assert not (here / MARKER).exists()
