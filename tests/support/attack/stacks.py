"""OpenSCENARIO files; cheap twins, ensembles of models, controllers that are functions, and syntheses."""

import re
from pathlib import Path

import damage
from attack.mutation import mutate_text, mutate_tree, mutate_xml, pick
from attack.texts import as_text, as_tree, reduce_sizes, scenarios

_RUN = ["--no-pictures", "--out", "o"]
_VALUE = re.compile(r'(?<==")([^"]*)(?=")')
_NUMBERS = [
    "0",
    "-1",
    "0.5",
    "1",
    "3.0",
    "20",
    "1e9",
    "${$EgoSpeed / 2}",
    "${1 / 0}",
    "$Braking",
    "$none",
    "-3",
]
_PARAMETERS = [
    "Braking=-3", "Braking=1e300", "EgoSpeed={normal: {mean: 20, sd: 2}}", "CutInGap=0.0", "None=1",
    "LaneChangeTime=0", "LaneChangeTime={uniform: {low: -1, high: 1}}", "CutInSpeed=x", "EgoSpeed=1e9",
]  # fmt: skip


def strike_openscenario(random):
    """Damage a scenario, its road or its distributions, and return the words of the command that reads it."""
    path = Path(pick(random, ["scene.xosc", "scene.xosc", "scene.xosc", "drawn.xosc", "road.xodr"]))
    text = path.read_text()
    path.write_bytes(_gently(text, random) if random.random() < 0.6 else mutate_xml(text, random))
    words = [f"--set=simulator.parameters.{pick(random, _PARAMETERS)}"] if random.random() < 0.2 else []
    words += ["--set=simulator.entity=CutIn"] if random.random() < 0.05 else []
    words += ["--set=simulator.ignore_ego_events=true"] if random.random() < 0.1 else []
    commands = [["validate"], ["validate", "--build"], ["run", *_RUN]]
    return [*commands[int(random.choice(3, p=[0.4, 0.2, 0.4]))], "scene.yaml", *words]


def _gently(text, random) -> bytes:
    """Give one to three attributes another value or a number nearby, so that many files are still read."""
    for _ in range(pick(random, [1, 1, 1, 2, 3])):
        found = list(_VALUE.finditer(text))
        match = pick(random, found)
        siblings = [one[0] for one in found if _is_number(one[0]) == _is_number(match[0])]
        if _is_number(match[0]) and random.random() < 0.7:
            number = float(match[0])
            near = [number / 2, number * 2, number + 1, number - 1, -number, 1.1 * number]
            siblings = [*map(str, near), pick(random, _NUMBERS)]
        value = pick(random, siblings)
        text = text[: match.start()] + value + text[match.end() :]
    return text.encode()


def _is_number(text):
    return re.fullmatch(r"-?\d[\d.]*", text) is not None


def strike(random):
    """Damage one of the others, and return the words of the command that reads it."""
    return pick(random, [_twin, _twin, _ensemble, _function, _synthesis])(random)


def _twin(random):
    tree = as_tree(Path("twin.yaml").read_text())
    tree["estimator"] = {"plugin": pick(random, ["mfmc", "mc", "auto"]), "rollouts": 100}
    for part in ("cheap", "ensemble", "exposure"):
        if random.random() < 0.3:
            del tree[part]
    tree = reduce_sizes(mutate_tree(tree, random, [scenarios()["cartpole"]]))
    Path("twin.yaml").write_bytes(as_text(tree))
    run = ["run", *_RUN, "--budget", "rollouts=100"]  # each member of an ensemble has it again
    return [*pick(random, [["validate"], ["validate", "--build"], run, run]), "twin.yaml"]


def _ensemble(random):
    path = Path("ensemble.npz")
    path.write_bytes(damage.damage_arrays(path.read_bytes(), random))
    members = pick(random, ["[1, 2]", "[1, 2]", "[0, 3]", "[2]", "[1, 1.5]", "[]", "[-1, 1]", "{}", "[x, 1]"])
    words = ["--set=perception.model=ensemble.npz", f"--set=ensemble={{perception.member: {members}}}"]
    return [*pick(random, [["validate", "--build"], ["run", *_RUN]]), "pem.yaml", *words]


_ANSWERS = [
    "None", "'fast'", "1.0", "(1.0,)", "(1.0, 2.0, 3.0)", "(float('nan'), 0.0)", "(0.0, float('inf'))",
    "[0, 0]",
    "(1j, 0.0)", "([1.0] * 7, 0.0)", "(object(), 0.0)", "(1e308, -1e308)", "(True, False)", "('1', '2')",
    "iter(())", "1 / 0", "observation.nothing", "exit(3)", "(10**400, 0.0)", "(0.0, observation.ego.speed)",
    "act", "{}", "(observation.ego.speed, observation.ego.heading)", "open('none')", "[][1]", "[10] * 3",
    "(None, None)",
]  # fmt: skip


def _function(random):
    """Let the user's own function answer oddly: its mistakes must be told as its own."""
    path = Path("pilot.py")
    text = path.read_text().replace("(1.0, 0.0)", pick(random, _ANSWERS))
    if random.random() < 0.2:
        text = mutate_text(text, random, ["raise ValueError('\x1b[31m')\n", "def act(): pass\n", "return\n"])
    path.write_bytes(text.encode("utf-8", "surrogatepass"))
    words = pick(random, [[], [], ["--set=controller.batched=true"], ["--set=controller.function=nothing"]])
    safe = ["--safe"] if random.random() < 0.1 else []
    return [*pick(random, [["validate", "--build"], ["run", *_RUN]]), "scene.yaml", *words, *safe]


_PLACES = [
    "mean",
    "covariance",
    "process_noise",
    "gain",
    "observer",
    "simulator.A",
    "simulator.process_noise",
]


def _synthesis(random):
    tree = reduce_sizes(mutate_tree(as_tree(Path("linear.yaml").read_text()), random, ()))
    Path("linear.yaml").write_bytes(as_text(tree))
    parameter = pick(random, [*_PLACES, "mean", "simulator.initial.mean", "steps", "x.y"])
    words = ["--parameter", parameter, "--steps", "1", "--out", "better"]
    if "." in parameter:
        words += ["--budget", "rollouts=60", "--proof", "40"]
    else:
        words += ["--chains", str(pick(random, [0, 5, 10])), "--runs", "2"]
    return ["synthesise", "linear.yaml", *words]


def small_ensemble(path: Path) -> None:
    """Write a perception error model with two members."""
    from dataclasses import replace

    from avrare_gp_pem.runtime.store import load, locate, save

    model = load(locate("measured"))
    save(path, replace(model, ensemble=(load(locate("pointpillars")), model)))
