"""Undamaged files of every kind that may come from someone else, written by the program itself."""

import contextlib
import io
import os
import signal
from pathlib import Path

import numpy as np
import pytest

from avrare.cli.main import main
from avrare.estimation.loop import checkpoint
from avrare.plugin.registry import default_registry

ROOT = Path(__file__).parents[2]
SCENARIO = """\
name: walk
steps: 8
simulator: {plugin: toy_walk, scale: 0.15}
specifications:
  near: {stl: "always (x < 0.9)"}
  far: {stl: "always (x < 1.2)"}
estimator: ESTIMATOR
chunk: 10
thresholds:
  - {specification: far, probability: "< 0.1"}
"""
LONGEST = 20.0
"""Seconds of computing after which a command is said to hang."""
ESTIMATORS = {
    "mc": "{plugin: mc, rollouts: 80}",
    "ams": "{plugin: ams, particles: 12, discard: 3, runs: 2}",
    "is": "{plugin: is, rollouts: 60, proposal: {name: gaussian, mean: 0.3}}",
}
POLICY = """\
name: policy
steps: 3
simulator: {plugin: gymnasium, env: Pendulum-v1, dt: 0.05, signals: {height: 0},
  noise: {stream: {by: tape, at: reset, numbers: 2}}}
controller: {plugin: policy, model: policy.npz}
specifications: {upright: {stl: "always (height > 0.9)"}}
estimator: {plugin: mc, rollouts: 4}
"""


def call(*words):
    """Run a command in this process: (exit code, what it printed)."""
    out = io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(out):
        return main([*words]), out.getvalue()


def succeed(*words, codes=(0,)):
    code, text = call(*words)
    assert code in codes, text


@contextlib.contextmanager
def time_limit():
    def stop(*_):
        raise TimeoutError("it hangs")

    before = signal.signal(signal.SIGVTALRM, stop)
    signal.setitimer(signal.ITIMER_VIRTUAL, LONGEST)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)
        signal.signal(signal.SIGVTALRM, before)


@contextlib.contextmanager
def make_material(folder):
    """Fill a folder with undamaged files; inside the toy plugin is installed."""
    with pytest.MonkeyPatch.context() as patch, contextlib.chdir(folder):
        patch.syspath_prepend(str(ROOT / "tests" / "cli" / "resume" / "toy"))
        patch.delenv("AVRARE_PLUGINS", raising=False)
        patch.setattr(os, "fsync", lambda handle: None)
        default_registry.cache_clear()
        write_runs(patch)
        write_drives()
        write_policy()
        yield
    default_registry.cache_clear()


def write_runs(patch):
    for name, estimator in ESTIMATORS.items():
        Path(f"{name}.yaml").write_text(SCENARIO.replace("ESTIMATOR", estimator))
        succeed("run", f"{name}.yaml", "--out", f"whole_{name}", "--no-pictures", "--failures", "failures")
        with patch.context() as interruption:
            interrupt(interruption)
            succeed("run", f"{name}.yaml", "--out", f"torn_{name}", "--no-pictures", codes=(2,))
    succeed("check", "mc.yaml", "--baseline", "baselines", "--save", codes=(0, 1, 3))


def interrupt(patch, chunks=4):
    """Interrupt the next run after so many chunks."""
    write, written = checkpoint.FileJournal.write, []

    def write_some(self, *chunk):
        write(self, *chunk)
        written.append(chunk)
        if len(written) == chunks:
            raise KeyboardInterrupt

    patch.setattr(checkpoint.FileJournal, "write", write_some)


def write_drives():
    from avrare.results.recordings import parse_road
    from avrare_recordings.formats.commonroad import to_commonroad
    from avrare_recordings.formats.csv_recording import read_csv

    Path("drive.csv").write_text("".join((ROOT / "docs" / "cut_in.csv").open().readlines()[:61]))
    rows = [f"{0.1 * i:.1f},{10 - 0.1 * i:.2f},{np.sin(i):.3f},{i > 9:d}" for i in range(30)]
    Path("signals.csv").write_text("\n".join(["time,gap,q,p", *rows]))
    recording = read_csv("drive.csv", "ego", parse_road("-1.75,1.75,5.25", 3.5, "0"))
    Path("drive.xml").write_text(to_commonroad(recording, "drive"))
    rules = ROOT / "plugins/avrare-traffic-rules/src/avrare_traffic_rules/rules.yaml"
    Path("rules.yaml").write_text(rules.read_text())


def write_policy():
    from avrare_policy.network import Network, save

    random = np.random.default_rng(0)
    weights = tuple(random.normal(size=shape).astype("f4") for shape in ((3, 4), (4, 1)))
    limits = np.zeros(3), np.ones(3), np.full(1, -2.0), np.full(1, 2.0)
    save(
        Path("policy.npz"), Network(weights, (np.zeros(4), np.zeros(1)), "tanh", *limits, {"source": "here"})
    )
    Path("policy.yaml").write_text(POLICY)
    succeed("run", "policy.yaml", "--out", "policy", "--no-pictures")
