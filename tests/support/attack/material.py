"""Undamaged inputs of every kind, which the product itself writes before the attack."""

import contextlib
import io
import json
import os
import shutil
import sys
from pathlib import Path

import numpy as np
import yaml

from avrare.cli.main import main
from avrare.estimation.loop import checkpoint
from avrare.scenario.yaml import dump
from pushed_point import pushed_point

ROOT = Path(__file__).parents[3]
TOY = ROOT / "tests" / "cli" / "resume" / "toy"
WALK = """\
name: walk
steps: 8
simulator: {plugin: toy_walk, scale: 0.15}
specifications:
  near: {stl: "always (x < 0.9)"}
  far: {stl: "always (x < 1.2)"}
estimator: {plugin: mc, rollouts: 80}
chunk: 10
thresholds:
  - {specification: far, probability: "< 0.1"}
"""
ESTIMATORS = {
    "mc": "{plugin: mc, rollouts: 60}",
    "ams": "{plugin: ams, particles: 12, discard: 3, runs: 2}",
    "is": "{plugin: is, rollouts: 60, proposal: {name: gaussian, mean: 0.3}}",
    "ce": "{plugin: ce, rollouts: 60}",
    "ess": "{plugin: ess, chains: 6, runs: 1}",
    "smc": "{plugin: smc, particles: 20, runs: 2, pilot: 200, stages: 1, times: 2}",
    "auto": "{plugin: auto, rollouts: 5000}",  # the least with which it learns
}
CATALOGUE = """\
name: walks
scenes:
  - {name: short, scenario: walk.yaml, exposure: {count: 30, hours: 10.0}}
  - {name: wide, scenario: walk.yaml, set: ["simulator.scale=0.2"], exposure: {per_hour: 2.0}}
  - name: rare
    scenario: walk.yaml
    exposure: {per_hour: 0.1}
    estimator: {plugin: ams, particles: 20, discard: 4, runs: 2, specifications: [near]}
thresholds:
  - {rule: near, per_hour: "< 0.5"}
pilot: 40
budget: {rollouts: 200}
"""
LINEAR = pushed_point(0.5, steps=5, variance=0.04)
TWIN = (
    WALK.replace("rollouts: 80", "rollouts: 200")
    + """\
cheap: {cost: 0.2, simulator: {scale: 0.17}}
ensemble: {simulator.scale: [0.14, 0.15, 0.16]}
exposure: {count: 30, hours: 10.0}
"""
)
SCENE = """\
name: scene
steps: 4
simulator:
  plugin: openscenario
  file: drawn.xosc
  parameters: {Braking: 3.0}
  ego: {friction: 1.0}
controller: {plugin: function, file: pilot.py}
specifications:
  hit: {plugin: traffic_rules, rule: no_collision}
estimator: {plugin: mc, rollouts: 2}
"""
PILOT = """\
def act(observation):
    speed = observation.ego.speed
    return (1.0, 0.0)
"""
MODELS = {
    "policy": """\
name: policy
steps: 3
simulator:
  plugin: gymnasium
  env: Pendulum-v1
  dt: 0.05
  signals: {height: 0}
  noise: {stream: {by: tape, at: reset, numbers: 2}}
controller: {plugin: policy, model: policy.npz}
specifications: {upright: {stl: "always (height > 0.9)"}}
estimator: {plugin: mc, rollouts: 4}
""",
    "flow": """\
name: flow
steps: 3
simulator:
  plugin: transformed
  flow: flow.npz
  simulator: {plugin: linear, states: [x, y], A: [[1, 0], [0, 1]], process_noise: [1, 1],
    initial: {mean: [0, 0], covariance: [1, 1]}}
specifications: {low: {stl: "x + y < 10"}}
estimator: {plugin: mc, rollouts: 4}
""",
    "pem": """\
name: pem
steps: 3
simulator: {plugin: highway_env, scene: highway, dt: 0.1, lanes: 3, vehicles: 2}
perception: {plugin: gp_pem, model: pem.npz}
tracker: {plugin: imm}
controller: {plugin: path_follower, waypoints: [[0.0, 0.0], [500.0, 0.0]]}
specifications: {safe: {stl: "always (crashed < 0.5)"}}
estimator: {plugin: mc, rollouts: 2}
""",
}
_PARTS = {
    "scenarios": {"walk.yaml", "catalogue.yaml", "linear.yaml", *(f"{name}.yaml" for name in ESTIMATORS)},
    "results": {"run", "failures", "baselines"},
    "studies": {"search", "rates", "learned_is.json", "learned_smc.json"},
    "checkpoints": {f"{state}_{name}" for state in ("torn", "whole") for name in ESTIMATORS},
    "drives": {"drive.csv", "signals.csv", "drive.xml", "rules.yaml", "drives"},
    "models": {f"{name}.{kind}" for name in ("policy", "flow", "pem", "spline") for kind in ("yaml", "npz")},
    "stacks": {
        "scene.yaml",
        "scene.xosc",
        "drawn.xosc",
        "road.xodr",
        "pilot.py",
        "twin.yaml",
        "ensemble.npz",
    },
    "fits": {
        "detections.csv",
        "vehicles.txt",
        "labels.txt",
        "samples.npy",
        "samples.csv",
        "policy.zip",
        "policy.pt",
    },
}
"""Part of the material -> its names; each part is made by a function of its own."""
SEARCH = [
    "require",
    "walk.yaml",
    "--parameter",
    "simulator.scale",
    "--specification",
    "near",
    "--probability",
    "< 0.1",
    "--budget",
    "rollouts=400",
    "--out",
    "search",
]
LEARNING = ["--set", "estimator.rollouts=3000", "--set", "estimator.pilot=3000", "--set", "chunk=1000"]
RULES_DRIVE = ["drive.csv", "--lanes", "-1.75,1.75,5.25", "--access-ramp", "0"]


def material(home, name) -> Path:
    """Return a file or folder of the material, which is made when it is first asked for.

    ``home`` is entered by ``inside``.
    """
    folder, part = home / "material", next(part for part, names in _PARTS.items() if name in names)
    if not (folder / part).exists():
        folder.mkdir(parents=True, exist_ok=True)
        with contextlib.chdir(folder):
            globals()[f"_make_{part}"]()
        (folder / part).touch()
    return folder / name


def copy_material(home, name, place) -> None:
    """Copy a file or folder of the material into another folder."""
    source = material(home, name)
    (shutil.copytree if source.is_dir() else shutil.copyfile)(source, Path(place) / name)


@contextlib.contextmanager
def inside(folder):
    """Work in a folder, with all plugins and the toy one; nothing is flushed: no attack cuts the power."""
    from avrare.plugin.registry import default_registry

    before, variable = os.getcwd(), os.environ.pop("AVRARE_PLUGINS", None)
    os.chdir(folder)
    sys.path.insert(0, str(TOY))
    path, os.environ["PATH"] = os.environ["PATH"], ""  # no git: each result asks it for the commit
    fsync, os.fsync = os.fsync, lambda handle: None
    default_registry.cache_clear()
    try:
        yield folder
    finally:
        os.chdir(before)
        sys.path.remove(str(TOY))
        os.environ["PATH"], os.fsync = path, fsync
        default_registry.cache_clear()
        if variable is not None:
            os.environ["AVRARE_PLUGINS"] = variable


def quietly(*words, codes=(0,)):
    """Run a command that must succeed; its output is dropped."""
    out = io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(out):
        code = main([*words])
    assert code in codes, (words, code, out.getvalue())


def walk(estimator, name="walk"):
    """Text of the toy scenario with an estimator."""
    text = WALK.replace("name: walk", f"name: {name}")
    text = text.replace("chunk: 10", "chunk: 250") if estimator == "auto" else text
    return text.replace("{plugin: mc, rollouts: 80}", ESTIMATORS[estimator])


def result(folder):
    """Content of result.json without the seconds; None where there is none."""
    path = Path(folder) / "result.json"
    if not path.exists():
        return None
    content = json.loads(path.read_text())
    for entry in content["estimates"]:
        del entry["seconds"]
    return content


def _make_scenarios():
    Path("walk.yaml").write_text(WALK)
    Path("catalogue.yaml").write_text(CATALOGUE)
    Path("linear.yaml").write_text(LINEAR)
    for name in ESTIMATORS:
        Path(f"{name}.yaml").write_text(walk(name))


def _make_results():
    material(Path("..").resolve(), "walk.yaml")
    quietly("run", "walk.yaml", "--out", "run", "--no-pictures", "--failures", "failures")
    quietly("check", "walk.yaml", "--baseline", "baselines", "--save", codes=(0, 1, 3))
    quietly("check", "walk.yaml", "--baseline", "baselines", "--save", "--set", "seed=1", codes=(0, 1, 3))


def _make_studies():
    home = Path("..").resolve()
    for name in ("walk.yaml", "catalogue.yaml", "smc.yaml"):
        material(home, name)
    quietly(*SEARCH, codes=(0, 3))
    _interrupt(*SEARCH)
    quietly("rate", "catalogue.yaml", "--quiet", "--out", "rates", codes=(0, 3))
    quietly("run", "smc.yaml", "--out", "learning", "--no-pictures")
    shutil.move("learning/learned.json", "learned_smc.json")
    shutil.rmtree("learning")
    quietly("run", "walk.yaml", "--estimator", "is", *LEARNING, "--out", "learning", "--no-pictures")
    shutil.move("learning/learned.json", "learned_is.json")


def _make_checkpoints():
    for name in ESTIMATORS:
        material(Path("..").resolve(), f"{name}.yaml")
        quietly("run", f"{name}.yaml", "--out", f"whole_{name}", "--no-pictures")
        _interrupt("run", f"{name}.yaml", "--out", f"torn_{name}", "--no-pictures")


def _interrupt(*words):
    """Interrupt a command after four chunks."""
    write, chunks = checkpoint.FileJournal.write, []

    def write_four(self, *chunk):
        write(self, *chunk)
        chunks.append(chunk)
        if len(chunks) == 4:
            raise KeyboardInterrupt

    checkpoint.FileJournal.write = write_four
    try:
        quietly(*words, codes=(2,))
    finally:
        checkpoint.FileJournal.write = write


def _make_drives():
    from avrare.results.recordings.recording import parse_road
    from avrare_recordings.formats.commonroad import to_commonroad
    from avrare_recordings.formats.csv_recording import read_csv

    lines = (ROOT / "docs" / "cut_in.csv").read_text().splitlines()
    Path("drive.csv").write_text("\n".join(lines[: 1 + 3 * 20]) + "\n")
    times = np.arange(0.0, 3.0, 0.1)
    rows = [f"{t:.1f},{10 - t:.3f},{np.sin(t):.4f},{int(t > 1)}" for t in times]
    Path("signals.csv").write_text("\n".join(["time,gap,speed,p", *rows]) + "\n")
    recording = read_csv("drive.csv", "ego", parse_road("-1.75,1.75,5.25", 3.5, "0"))
    Path("drive.xml").write_text(to_commonroad(recording, "drive"))
    Path("drives").mkdir()
    for name in ("one", "two"):
        (Path("drives") / f"{name}.xml").write_text(Path("drive.xml").read_text())
    rules = yaml.safe_load(
        (ROOT / "plugins/avrare-traffic-rules/src/avrare_traffic_rules/rules.yaml").read_text()
    )
    rules["rules"] = {name: rules["rules"][name] for name in ("R_G1", "R_G2", "R_I2", "no_collision")}
    Path("rules.yaml").write_text(dump(rules))


def _make_models():
    from avrare_flows.flow import AffineCoupling, Flow, SplineAutoregressive
    from avrare_flows.flow import Network as FlowNetwork
    from avrare_policy.network import Network, save

    random = np.random.default_rng(0)

    def layers(*sizes):
        pairs = list(zip(sizes[1:], sizes[:-1], strict=True))
        return tuple(random.normal(size=pair) for pair in pairs), tuple(np.zeros(pair[0]) for pair in pairs)

    coupling = AffineCoupling(FlowNetwork(*layers(1, 4, 2)))
    Flow("affine_coupling", (coupling,) * 2, np.zeros(2), np.ones(2), 9).save("flow.npz")
    spline = SplineAutoregressive(FlowNetwork(*layers(2, 4, 2 * 11)), 4.0)
    Flow("spline_autoregressive", (spline,), np.zeros(2), np.ones(2), 9).save("spline.npz")
    weights, biases = layers(3, 4, 1)
    numbers = np.zeros(3), np.ones(3), np.full(1, -2.0), np.full(1, 2.0)
    policy = Network(tuple(w.T.astype("f4") for w in weights), biases, "tanh", *numbers, {"source": "here"})
    save(Path("policy.npz"), policy)
    shutil.copy(ROOT / "plugins/avrare-gp-pem/src/avrare_gp_pem/models/best.npz", "pem.npz")
    for name, text in MODELS.items():
        Path(f"{name}.yaml").write_text(text)
        quietly("validate", "--build", f"{name}.yaml")


def _make_stacks():
    from attack.stacks import small_ensemble

    source = ROOT / "scenarios" / "openscenario"
    text = (source / "cut_in.xosc").read_text()
    Path("scene.xosc").write_text(text.replace("motorway.xodr", "road.xodr"))
    text = (source / "cut_in_distributions.xosc").read_text()
    Path("drawn.xosc").write_text(text.replace("cut_in.xosc", "scene.xosc"))
    shutil.copy(source / "motorway.xodr", "road.xodr")
    for name, text in (("twin.yaml", TWIN), ("scene.yaml", SCENE), ("pilot.py", PILOT)):
        Path(name).write_text(text)
    for name in ("twin", "scene"):
        quietly("validate", "--build", f"{name}.yaml")
    small_ensemble(Path("ensemble.npz"))


def _make_fits():
    from attack import fits

    fits.make()
