"""Whatever is done to a file, its command ends soon: with an answer, or with a message and exit code 4 or 5.

A failure names its seed; ``attack("scenario", 17, material)`` repeats it.
"""

import contextlib
import json
import re
import shutil
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import yaml

import damage
from avrare.scenario.overrides import read_extended
from damage import pick
from untrusted_files import ESTIMATORS, ROOT, call, make_material, time_limit

CODES = {"validate": {0, 4, 5}, "run": {0, 4, 5, 6}, "failures": {0, 4, 5}, "report": {0, 4, 5}}
"""Exit codes that damage may lead to; of other commands also 1 and 3, the verdicts."""
ROAD = ("--lanes", "-1.75,1.75,5.25", "--access-ramp", "0")
RULES = ("R_G1", "R_G2", "R_I2", "no_collision")
TOKENS = (
    ("and", "or", "xor", "->", "<->", "until", "since"), ("not", "always", "eventually", "once"),
    ("<", "<=", ">", ">=", "==", "!="), ("0", "1", "0.5", "1e308", "9" * 40), ("p", "q", "gap", "ego", "abs"),
    ("[3,1]", "[0,1e9]", "[0,100ms]", "rise(", "forall o in others: ", "at_least 2 o in others: "),
)  # fmt: skip
"""Parts of formulas; one of a group in place of another often makes a formula again."""
LARGEST = {"steps": 30, "rollouts": 40, "particles": 20, "chains": 10, "runs": 3, "chunk": 1000}


@cache
def shipped_scenarios():
    return [read_extended(str(path)).plain() for path in sorted((ROOT / "scenarios").glob("*.yaml"))]


@cache
def shipped_formulas():
    cases = json.loads((ROOT / "tests" / "data" / "stl_cases.json").read_text())
    return [case["formula"] for case in (cases["cases"] if isinstance(cases, dict) else cases)]


def rewrite(path, damaged, random):
    """Replace a file by what a function of its content and the generator returns."""
    path = Path(path)
    content = damaged(path.read_bytes() if path.suffix in (".json", ".npz") else path.read_text(), random)
    path.write_bytes(content if isinstance(content, bytes) else content.encode("utf-8", "surrogatepass"))


def as_yaml(tree):
    try:
        return yaml.safe_dump(tree, sort_keys=False, allow_unicode=True)
    except Exception:  # what YAML's writer refuses is JSON, which is YAML
        return json.dumps(tree)


def damage_yaml(text, random):
    if random.random() < 0.3:
        return damage.damage_text(text, random)
    return as_yaml(damage.damage_tree(yaml.safe_load(text), random))


def damage_scenario(random):
    Path("s.yaml").write_text(as_yaml(pick(random, shipped_scenarios())))
    if random.random() < 0.2:
        setting = damage.damage_text(f"{pick(random, ['steps', 'estimator', 'seed', '.'])}=3", random)
        return "validate", "s.yaml", f"--set={setting}"
    rewrite("s.yaml", damage_yaml, random)
    return "validate", "s.yaml", *pick(random, [(), ("--safe",)])


def damage_scenario_to_run(random):
    tree = damage.damage_tree(
        yaml.safe_load(Path(f"{pick(random, list(ESTIMATORS))}.yaml").read_text()), random
    )
    for block in (tree, tree.get("estimator"), tree.get("simulator")):
        for key in LARGEST.keys() & (block if isinstance(block, dict) else {}):
            if type(block[key]) in (int, float):
                block[key] = min(block[key], LARGEST[key])
    Path("s.yaml").write_text(as_yaml(tree), errors="surrogatepass")
    return "run", "s.yaml", "--out", "out", "--no-pictures", "--budget", "rollouts=20"


def damage_formula(random):
    many = 10 ** int(random.integers(1, 5))
    deep = [
        "(" * many + "p" + ")" * many,
        "not " * many + "p",
        " and ".join(["p > 0"] * many),
        "p -> " * many + "p",
    ]
    formula, group = pick(random, shipped_formulas()), pick(random, TOKENS)
    match random.integers(10):
        case 0:
            formula = pick(random, deep)
        case 1 | 2 | 3:
            formula = damage.damage_text(formula, random, [token for group in TOKENS for token in group])
        case _:
            formula = re.sub(
                rf"(?<!\S)({'|'.join(map(re.escape, group))})(?!\S)", lambda _: pick(random, group), formula
            )
    return "monitor", *pick(random, [("signals.csv",), ("drive.csv", *ROAD)]), f"--stl={formula}"


def damage_rules(random):
    rewrite("rules.yaml", damage_yaml, random)
    return "monitor", "drive.csv", *ROAD, "--rule", pick(random, RULES), "--set", "rules_file=rules.yaml"


def damage_csv(random):
    if random.random() < 0.5:
        rewrite("signals.csv", damage.damage_table, random)
        return "monitor", "signals.csv", "--stl", "always (gap > 2 and q < 2)"
    rewrite("drive.csv", damage.damage_table, random)
    return "monitor", "drive.csv", *ROAD, "--rule", pick(random, RULES)


def damage_commonroad(random):
    rewrite("drive.xml", damage.damage_text, random)
    return "monitor", "drive.xml", "--ego", "1", "--rule", pick(random, RULES)


RUN_COMMANDS = (
    "report run", "run --out run --resume", "replay --run run --specification far", "monitor run",
    "failures add run --failures new", "check mc.yaml --baseline run --plan",
)  # fmt: skip


def damage_run_folder(random):
    shutil.copytree("whole_mc", "run")
    path = Path("run") / pick(random, ["result.json", "provenance.json", "failures.npz", "scenario.yaml"])
    damages = {".json": damage.damage_json, ".npz": damage.damage_arrays, ".yaml": damage_yaml}
    rewrite(path, damages[path.suffix], random)
    return tuple(pick(random, RUN_COMMANDS).split())


def damage_checkpoint(random):
    name = pick(random, list(ESTIMATORS))
    shutil.copytree(f"torn_{name}", "run")
    path = pick(random, sorted(Path("run").rglob("*.npz")))
    if random.random() < 0.2:
        rewrite("run/checkpoint/checkpoint.json", damage.damage_json, random)
    elif random.random() < 0.2:
        path.rename(path.with_name(pick(random, ["000000-000009.npz", "x.npz", ".y.tmp"])))
    else:
        rewrite(path, damage.damage_arrays, random)
    return "run", f"{name}.yaml", "--out", "run", "--resume", "--no-pictures"


def damage_baseline(random):
    rewrite(next(Path("baselines").glob("*.json")), damage.damage_json, random)
    return "check", "mc.yaml", "--baseline", "baselines", "--set", "estimator.rollouts=30", "--plan"


def damage_failure(random):
    path = pick(random, sorted(Path("failures").glob("*.npz")))
    if random.random() < 0.3:
        Path("blob").write_bytes(
            damage.damage_bytes(call("failures", "blob", path.stem[:8])[1].encode(), random)
        )
        return "replay", "mc.yaml", "--blob", "@blob"
    rewrite(path, damage.damage_arrays, random)
    words = pick(
        random,
        ["failures list", f"failures blob {path.stem[:8]}", f"replay mc.yaml --failure {path.stem[:8]}"],
    )
    return *words.split(), "--failures", "failures"


def damage_policy(random):
    rewrite("policy.npz", damage.damage_arrays, random)
    return "run", "policy.yaml", "--out", "out", "--no-pictures"


ATTACKS = {
    damage_scenario: (60, ""), damage_scenario_to_run: (20, "*.yaml"), damage_formula: (60, "*.csv"),
    damage_rules: (10, "drive.csv rules.yaml"), damage_csv: (80, "*.csv"), damage_commonroad: (20, "*.xml"),
    damage_run_folder: (30, "mc.yaml whole_mc"), damage_checkpoint: (20, "*.yaml torn_* whole_*"),
    damage_baseline: (20, "mc.yaml baselines"), damage_failure: (30, "mc.yaml failures"),
    damage_policy: (20, "policy.*"),
}  # fmt: skip
"""How a file is damaged -> how often, and the material that it takes."""


@pytest.fixture(scope="module")
def material(tmp_path_factory):
    folder = tmp_path_factory.mktemp("material")
    with make_material(folder):
        yield folder


def attack(damaging, seed, material):
    """Return the exit code of reading a damaged file, and what is wrong with the answer, if anything."""
    work = material / "work"
    shutil.rmtree(work, ignore_errors=True)
    work.mkdir()
    for path in (path for pattern in ATTACKS[damaging][1].split() for path in material.glob(pattern)):
        (shutil.copytree if path.is_dir() else shutil.copy)(path, work / path.name)
    random = np.random.default_rng([seed, len(damaging.__name__)])
    with contextlib.chdir(work), time_limit():
        words = damaging(random)
        code, text = call(*words)
        trouble = complaint(words, code, text)
    return code, trouble and f"seed {seed}: avrare {' '.join(words)[:500]}: {trouble}: {text[-1500:]}"


def complaint(words, code, text):
    if "Traceback" in text or code not in CODES.get(words[0], {0, 1, 3, 4, 5, 6}):
        return f"exit code {code}"
    if code in (4, 5) and not text.strip():
        return "no message"
    if any(sign in text for sign in "\x1b\x07\x9b\u202e"):
        return "control characters"
    if code == 0 and "--resume" in words and Path(words[1]).stem in ESTIMATORS:
        undisturbed, resumed = (estimates(folder) for folder in (f"whole_{Path(words[1]).stem}", "run"))
        return None if resumed == undisturbed else "other numbers"
    pages = [path.read_text() for path in Path().glob("run/*.html")]
    marked = any("<script>alert" in page or "\x1b" in page for page in pages)
    return "markup in the report" if marked else None


def estimates(folder):
    content = json.loads((Path(folder) / "result.json").read_text())["estimates"]
    return [{key: value for key, value in entry.items() if key != "seconds"} for entry in content]


@pytest.mark.parametrize("damaging", ATTACKS)
def test_damaged_files_are_read_or_refused(damaging, material):
    codes, troubles = zip(
        *(attack(damaging, seed, material) for seed in range(ATTACKS[damaging][0])), strict=True
    )
    assert not any(troubles), next(filter(None, troubles))
    assert {4, 5} & set(codes), "no file was refused"
    assert {0, 1, 3} & set(codes), "every file was refused"


@pytest.mark.slow
@pytest.mark.parametrize("damaging", ATTACKS)
def test_many_damaged_files_are_read_or_refused(damaging, material):
    count, _ = ATTACKS[damaging]
    assert not [
        trouble for seed in range(count, 10 * count) if (trouble := attack(damaging, seed, material)[1])
    ]
