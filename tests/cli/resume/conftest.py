import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from avrare.cli.main import main
from avrare.estimation.loop import checkpoint

ROOT = Path(__file__).parents[3]
TOY = Path(__file__).parent / "toy"
SCENARIO = """\
name: {name}
steps: 20
simulator: {{plugin: toy_walk, scale: 0.1}}
specifications:
  near: {{stl: "always (x < 0.9)"}}
  far: {{stl: "always (x < 1.2)"}}
estimator: {estimator}
chunk: 10
"""
ESTIMATORS = {
    "mc": "{plugin: mc, rollouts: 400}",
    "ams": "{plugin: ams, particles: 40, discard: 8, runs: 3}",
    "is": "{plugin: is, rollouts: 200, proposal: {name: gaussian, mean: 0.3}}",
    "smc": "{plugin: smc, particles: 50, runs: 2, pilot: 200, stages: 1, times: 3}",
}


def heed_signals():
    """Heed Ctrl-C as from a terminal: a shell lets what it runs in the background ignore it."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


@pytest.fixture(autouse=True)
def _heeding():
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


class Night:
    """A folder with toy scenarios, and ``avrare`` as a program of its own."""

    def __init__(self, folder):
        self.folder = folder
        self.environment = {
            **os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), str(TOY)]), "OMP_NUM_THREADS": "1",
            "AVRARE_PLUGINS": "toy,estimators",
        }  # fmt: skip

    def scenario(self, estimator="mc", name="walk"):
        path = self.folder / f"{name}.yaml"
        path.write_text(SCENARIO.format(name=name, estimator=ESTIMATORS.get(estimator, estimator)))
        return str(path)

    def start(self, *words, **environment):
        command = [sys.executable, "-m", "avrare", "run", *map(str, words), "--no-pictures"]
        return subprocess.Popen(
            command, cwd=self.folder, env={**self.environment, **environment}, text=True,
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True, preexec_fn=heed_signals,
        )  # fmt: skip

    def run(self, *words, code=0, **environment):
        process = self.start(*words, **environment)
        out, err = process.communicate(timeout=120)
        assert process.returncode == code, (process.returncode, err)
        assert "Traceback" not in err, err
        return out, err

    def result(self, out, name="."):
        """Return content of result.json without the seconds."""
        content = json.loads((self.folder / out / name / "result.json").read_text())
        for entry in content["estimates"]:
            del entry["seconds"]
        return content

    def saved(self, out):
        return sorted((self.folder / out / "checkpoint").rglob("*.npz"))


@pytest.fixture
def night(tmp_path):
    return Night(tmp_path)


@pytest.fixture
def inside(night, monkeypatch):
    """Return the same folder and plugins for calls in this process."""
    from avrare.plugin.registry import default_registry

    monkeypatch.chdir(night.folder)
    monkeypatch.syspath_prepend(str(TOY))
    monkeypatch.setenv("AVRARE_PLUGINS", "toy,estimators")
    default_registry.cache_clear()
    yield night
    default_registry.cache_clear()


@pytest.fixture
def stopping(monkeypatch):
    """Run a command, which is interrupted after so many chunks, and return how many it has saved."""

    def run(words, chunks=None):
        write, done = checkpoint.FileJournal.write, []

        def counting(self, *rest):
            write(self, *rest)
            done.append(rest)
            if len(done) == chunks:
                os.kill(os.getpid(), signal.SIGINT)

        with monkeypatch.context() as patch:
            patch.setattr(checkpoint.FileJournal, "write", counting)
            assert main(words) == (0 if chunks is None else 2)
        return len(done)

    return run


@pytest.fixture
def interrupted(stopping):
    """Run a command that is asked to stop once so many chunks are done."""

    def interrupt(chunks, *words):
        assert stopping(["run", *map(str, words), "--no-pictures"], chunks) == chunks

    return interrupt
