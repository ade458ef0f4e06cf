"""Kinds of inputs: how one of each is damaged, and the command that reads it."""

import contextlib
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import damage
from attack import command_lines, fits, formulas, stacks, studies
from attack.attempts import BITS, OUTPUT, Outcome, call, trouble
from attack.material import ESTIMATORS, MODELS, RULES_DRIVE, copy_material, material, result
from attack.mutation import WORDS, mutate_table, mutate_text, mutate_tree, mutate_xml, pick
from attack.texts import as_text, as_tree, reduce_sizes, scenarios

Words = list[str]


@dataclass(frozen=True)
class Kind:
    """Strike: damages copies of ``needs`` in the current folder, and returns the words of the command.

    Attributes:
        strike: Function of a random generator.
        needs: Files and folders of the material.
        examine: Name of what is wrong with the outcome beside what is wrong in general.
    """

    strike: Callable[[np.random.Generator], Words]
    needs: Sequence[str] = ()
    examine: Callable[[Outcome], str | None] = lambda outcome: None


def _scenario(random, name) -> bytes:
    tree = scenarios()[name]
    if random.random() < 0.7:
        return as_text(mutate_tree(tree, random, [pick(random, list(scenarios().values()))]))
    text = mutate_text(as_text(tree).decode(), random).encode("utf-8", "surrogatepass")
    return damage.damage_bytes(text, random) if random.random() < 0.2 else text


def _strike_scenario(random) -> Words:
    name = pick(random, list(scenarios()))
    what = random.random()
    if what < 0.7:
        Path("s.yaml").write_bytes(_scenario(random, name))
        return ["validate", "s.yaml"]
    if what < 0.9:
        Path("s.yaml").write_bytes(as_text(scenarios()[name]))
        return [
            "validate",
            "s.yaml",
            *[f"--set={_setting(random, name)}" for _ in range(random.integers(1, 4))],
        ]
    Path("base.yaml").write_bytes(_scenario(random, name))
    Path("s.yaml").write_bytes(as_text({"extends": "base.yaml", **mutate_tree(scenarios()[name], random)}))
    return ["validate", "s.yaml"]


def _setting(random, name) -> str:
    keys = list(_paths(scenarios()[name]))
    value = pick(random, [*WORDS, "[]", "{}", "1", "-1", "{a: [", "1e999", "!!x 1", "*a", "null"])
    return (
        mutate_text(f"{pick(random, keys)}={value}", random)
        if random.random() < 0.3
        else f"{pick(random, keys)}={value}"
    )


def _paths(tree, prefix=""):
    pairs = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    for key, value in pairs:
        yield f"{prefix}{key}"
        yield from _paths(value, f"{prefix}{key}.")


_CHEAP = ("cartpole", "pendulum", "glider", "glider_actuator", "constrained_gaussian", "four_squares", "walk")


def _strike_run(random) -> Words:
    name = pick(random, _CHEAP)
    tree = dict(as_tree(Path("walk.yaml").read_text()) if name == "walk" else scenarios()[name])
    tree["estimator"] = as_tree(ESTIMATORS[pick(random, list(ESTIMATORS))])
    tree = reduce_sizes(mutate_tree(reduce_sizes(tree), random, list(scenarios().values())[:3]))
    Path("s.yaml").write_bytes(as_text(tree))
    if random.random() < 0.3:
        return ["validate", "--build", "s.yaml"]
    return [
        "run",
        "s.yaml",
        "--out",
        "out",
        "--no-pictures",
        "--budget",
        pick(random, ["rollouts=20", "seconds=0.2"]),
    ]


def _strike_formula(random) -> Words:
    if random.random() < 0.6:
        return ["monitor", "signals.csv", f"--stl={formulas.formula(random, vehicles=False)}"]
    return ["monitor", *RULES_DRIVE, f"--stl={formulas.formula(random, vehicles=True)}"]


def _strike_rules(random) -> Words:
    text = Path("rules.yaml").read_text()
    tree = as_tree(text)
    names = list(tree["rules"])
    if random.random() < 0.7:
        changed = mutate_tree(tree, random)
        part = changed.get("rules") if isinstance(changed, dict) else None
        if isinstance(part, dict) and part and random.random() < 0.7:
            rule = part[pick(random, list(part))]
            if isinstance(rule, dict) and "formula" in rule:
                rule["formula"] = formulas.damage_formula(str(rule["formula"]), random)
        content = as_text(changed)
    else:
        content = mutate_text(text, random).encode("utf-8", "surrogatepass")
    Path("rules.yaml").write_bytes(
        damage.damage_bytes(content, random) if random.random() < 0.1 and content else content
    )
    return ["monitor", *RULES_DRIVE, "--rule", pick(random, names), "--set", "rules_file=rules.yaml"]


def _strike_csv(random) -> Words:
    path = Path(pick(random, ["drive.csv", "signals.csv"]))
    content = mutate_table(path.read_text(), random).encode("utf-8", "surrogatepass")
    path.write_bytes(damage.damage_bytes(content, random) if random.random() < 0.2 else content)
    if path.name == "signals.csv":
        return ["monitor", "signals.csv", "--stl", "always (gap > 2 and speed < 2)"]
    ego = ["--ego", pick(random, ["ego", "van", "", "x"])] if random.random() < 0.2 else []
    return ["monitor", *RULES_DRIVE, *ego, "--rule", pick(random, ["R_G1", "R_G2", "R_I2", "no_collision"])]


def _strike_commonroad(random) -> Words:
    path = Path("drive.xml")
    path.write_bytes(mutate_xml(path.read_text(), random))
    lanes = RULES_DRIVE[1:] if random.random() < 0.3 else []
    return [
        "monitor",
        "drive.xml",
        *lanes,
        "--ego",
        "1",
        "--rule",
        pick(random, ["R_G1", "R_G2", "no_collision"]),
    ]


_RUN_FILES = {
    "result.json": damage.damage_json, "provenance.json": damage.damage_json,
    "failures.npz": damage.damage_arrays, "rollouts.npz": damage.damage_arrays,
    "scenario.yaml": lambda content, random: as_text(mutate_tree(as_tree(content), random)),
}  # fmt: skip
_RUN_COMMANDS = [
    "report run", "run --out run --resume", "run --out run --resume --json",
    "replay --run run --specification far", "replay --run run", "failures add run --failures new",
    "monitor run", "monitor run --specification near --out m", "check walk.yaml --baseline run --plan",
    "replay --run run --specification near --failure 1 --export c.csv",
]  # fmt: skip


def _strike_run_folder(random) -> Words:
    for name in random.permutation(list(_RUN_FILES))[: int(random.integers(1, 3))]:
        path = Path("run") / name
        if random.random() < 0.05:
            path.unlink(missing_ok=True)
        elif path.exists():
            path.write_bytes(_RUN_FILES[name](path.read_bytes(), random))
    return pick(random, _RUN_COMMANDS).split()


def _clean_pages(outcome) -> str | None:
    """Check that names and texts of a run folder do nothing in the report."""
    pages = [path.read_text() for path in Path("run").glob("*.html")]
    return OUTPUT if any("\x1b" in page or "<script>alert" in page for page in pages) else None


def _strike_checkpoint(random) -> Words:
    cheap = [name for name in ESTIMATORS if name != "auto"]  # which learns for two seconds
    name = "auto" if random.random() < 0.03 else pick(random, cheap)
    home, folder = Path("..").resolve(), Path("torn")
    copy_material(home, f"torn_{name}", ".")
    copy_material(home, f"{name}.yaml", ".")
    Path(f"torn_{name}").rename(folder)
    Path("which").write_text(name)
    chunks = sorted(folder.rglob("*.npz"))
    what, path = random.integers(10), pick(random, chunks)
    if what == 0:
        path = folder / "checkpoint" / "checkpoint.json"
        path.write_bytes(damage.damage_json(path.read_bytes(), random))
    elif what == 1:
        path = next(folder.rglob("scenario.yaml"))
        path.write_bytes(as_text(mutate_tree(as_tree(path.read_bytes()), random)))
    elif what == 2:
        path.write_bytes(pick(random, chunks).read_bytes())
    elif what == 3:
        path.rename(
            path.with_name(pick(random, ["000000-000009.npz", "000001-000000.npz", "x.npz", ".y.tmp"]))
        )
    elif what == 4:
        pick(random, list(folder.rglob("*.*"))).unlink()
    else:
        path.write_bytes(damage.damage_arrays(path.read_bytes(), random))
    known = [f"{name}.yaml"] if random.random() < 0.3 else []
    return ["run", *known, "--out", "torn", "--resume", "--no-pictures"]


def _same_bits(outcome) -> str | None:
    """Tell when a damaged checkpoint was resumed to another number."""
    whole = result(material(Path("..").resolve(), f"whole_{Path('which').read_text()}"))
    return BITS if outcome.code == 0 and result("torn") != whole else None


def _strike_baseline(random) -> Words:
    path = pick(random, sorted(Path("baselines").glob("*.json")))
    if random.random() < 0.1:
        path.rename(
            path.with_name(pick(random, ["0009.json", "x.json", "99999999999999999999.json", "0001"]))
        )
    else:
        path.write_bytes(damage.damage_json(path.read_bytes(), random))
    plan = pick(
        random, [["--plan"], ["--plan"], ["--markdown", "m.md"], ["--save"], ["--json"], ["--accept-changes"]]
    )
    return ["check", "walk.yaml", "--baseline", "baselines", "--set", "estimator.rollouts=30", *plan]


def _strike_failure(random) -> Words:
    path = pick(random, sorted(Path("failures").glob("*.npz")))
    if random.random() < 0.1:
        path.rename(path.with_name(pick(random, ["x.npz", "\x1b[31m.npz", "00000000.npz", "a.json"])))
    else:
        path.write_bytes(damage.damage_arrays(path.read_bytes(), random))
    commands = [
        "list", "blob {id}", "replay walk.yaml --failure {id}",
        "run walk.yaml --no-pictures --out o --set estimator.rollouts=20",
        "replay walk.yaml --failure {id} --shrink --budget rollouts=5",
    ]  # fmt: skip
    words = pick(random, commands).format(id=path.stem[:8]).split()
    words = words if words[0] in ("replay", "run") else ["failures", *words]
    return [*words, "--failures", "failures"]


def _strike_blob(random) -> Words:
    text = call(
        ["failures", "blob", sorted(Path("failures").glob("*.npz"))[0].stem, "--failures", "failures"]
    ).out
    content = damage.damage_bytes(text.encode(), random)
    Path("blob").write_bytes(content)
    return ["replay", "walk.yaml", "--blob", "@blob"]


def _strike_model(random) -> Words:
    name = pick(random, ["policy", "flow", "flow", "policy", "pem"])
    path = Path(f"{name}.npz")
    content = (
        Path("spline.npz").read_bytes() if name == "flow" and random.random() < 0.5 else path.read_bytes()
    )
    path.write_bytes(damage.damage_arrays(content, random))
    assert name in MODELS
    return [["validate", "--build", f"{name}.yaml"], ["run", f"{name}.yaml", "--no-pictures", "--out", "o"]][
        int(random.integers(2))
    ]


KINDS = {
    "scenarios": Kind(_strike_scenario),
    "scenarios that run": Kind(_strike_run, ["walk.yaml"]),
    "formulas": Kind(_strike_formula, ["signals.csv", "drive.csv"]),
    "rules files": Kind(_strike_rules, ["rules.yaml", "drive.csv"]),
    "recorded drives (CSV)": Kind(_strike_csv, ["signals.csv", "drive.csv"]),
    "recorded drives (CommonRoad)": Kind(_strike_commonroad, ["drive.xml"]),
    "run folders": Kind(_strike_run_folder, ["run", "walk.yaml"], _clean_pages),
    "checkpoints": Kind(_strike_checkpoint, examine=_same_bits),
    "baselines": Kind(_strike_baseline, ["baselines", "walk.yaml"]),
    "stored failures": Kind(_strike_failure, ["failures", "walk.yaml"]),
    "failures as text": Kind(_strike_blob, ["failures", "walk.yaml"]),
    "models, policies and flows": Kind(
        _strike_model,
        ["policy.npz", "flow.npz", "spline.npz", "pem.npz", "policy.yaml", "flow.yaml", "pem.yaml"],
    ),
    "catalogues, searches and what was learned": Kind(
        studies.strike,
        ["walk.yaml", "catalogue.yaml", "search", "rates", "learned_is.json", "learned_smc.json"],
        studies.same_answer,
    ),
    "command lines": Kind(
        command_lines.words,
        ["walk.yaml", "run", "drive.csv", "signals.csv", "failures", "baselines"],
    ),
    "OpenSCENARIO files": Kind(
        stacks.strike_openscenario, ["scene.yaml", "scene.xosc", "drawn.xosc", "road.xodr", "pilot.py"]
    ),
    "twins, ensembles, functions and syntheses": Kind(
        stacks.strike,
        ["twin.yaml", "scene.yaml", "scene.xosc", "drawn.xosc", "road.xodr", "pilot.py", "linear.yaml",
         "pem.yaml", "ensemble.npz"],
    ),
    "tables to fit, and policies to convert": Kind(
        fits.strike,
        ["detections.csv", "vehicles.txt", "labels.txt", "pem.npz", "samples.npy", "samples.csv",
         "policy.zip", "policy.pt"],
    ),
}  # fmt: skip


def attempt(name, seed, home) -> tuple[str | None, str]:
    """Make input ``seed`` of a kind and give it to its command: (trouble or None, what was told).

    ``home`` is the folder with ``material``, entered by ``inside``; the input stays in ``home / "work"``.
    """
    kind, work = KINDS[name], home / "work"
    random = np.random.default_rng([seed, list(KINDS).index(name)])
    shutil.rmtree(work, ignore_errors=True)
    work.mkdir()
    for need in kind.needs:
        copy_material(home, need, work)
    with contextlib.chdir(work):
        outcome = call(kind.strike(random))
        found = trouble(outcome) or kind.examine(outcome)
    return found, outcome.told() if found else ""
