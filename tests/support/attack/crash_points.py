"""Crash points: a command killed at each file-system call leaves nothing, or what the next one mends."""

import contextlib
import io
import json
import os
import resource
import shutil
import signal
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from attack import fits, warm_workers
from attack.attempts import BITS, CODE, HANG, TRACEBACK
from attack.kills import Program, outlive
from attack.material import ESTIMATORS, copy_material, result

CHANGES = {
    "os.mkdir", "os.rename", "os.remove", "os.rmdir", "os.chmod", "os.truncate", "os.link", "os.symlink",
    "tempfile.mkstemp", "open", "shutil.rmtree", "shutil.copyfile",
}  # fmt: skip
TORN = (0, 1, 100, 511, 4096, 9000)
"""Sizes of a file beyond which a write kills the process: what is written is cut there."""
_ORDERS = [range(-len(TORN), 0), *(range(first, 10_000, 8) for first in (0, 4, 2, 6, 1, 5, 3, 7))]
_PATIENCE = 120.0


@dataclass(frozen=True)
class Task:
    """A command, the material that it needs, how it is repeated, and what it must have left in the end.

    Attributes:
        words: Words of the command.
        needs: Files and folders of the material.
        again: Words of the command after a crash, as the messages or the documentation advise.
        left: What must be equal to that of an undisturbed command.
        codes: Exit codes of a command that succeeds.
        prepare: Called in this process before the first command, which is forked from it.
    """

    words: list[str]
    left: Callable[[], object]
    needs: tuple[str, ...] = ()
    again: list[str] | None = None
    codes: tuple[int, ...] = (0,)
    prepare: Callable[[], None] = lambda: None


def _run(estimator, workers) -> Task:
    words = ["run", f"{estimator}.yaml", "--no-pictures", "--quiet", "--workers", str(workers)]
    again = ["run", "--out", "out", "--resume", "--no-pictures", "--quiet"]
    return Task(
        [*words, "--out", "out"],
        lambda: result("out"),
        (f"{estimator}.yaml",),
        again,
    )


def _texts(pattern):
    return lambda: [path.read_text() for path in sorted(Path().glob(pattern))]


def _failures():
    return sorted(path.name for path in Path("stored").glob("*.npz"))


def _baselines():
    entries = [json.loads(path.read_text()) for path in sorted(Path("saved").glob("*.json"))]
    return [entry["checksum"] for entry in entries][-1:]  # of all but the seconds


_FEW = ["--set", "estimator.rollouts=30"]
_SCALE = ["--parameter", "simulator.scale", "--specification", "near"]
TASKS = {
    **{f"run {name}, {workers} workers": _run(name, workers) for name in ESTIMATORS for workers in (1, 2)},
    "run --failures": Task(
        ["run", "walk.yaml", "--out", "out", "--no-pictures", "--failures", "stored"],
        lambda: (result("out"), _failures()), ("walk.yaml",),
        ["run", "--out", "out", "--resume", "--no-pictures", "--failures", "stored"],
    ),
    "report": Task(["report", "run"], lambda: len(Path("run/report.html").read_text()), ("run",)),
    "check --save": Task(
        ["check", "walk.yaml", "--baseline", "saved", "--save", *_FEW],
        _baselines, ("walk.yaml",), codes=(0, 1, 3),
    ),
    "check --out": Task(
        ["check", "walk.yaml", "--out", "out", "--junit", "j.xml", "--markdown", "m.md", *_FEW],
        lambda: result("out"), ("walk.yaml",), codes=(0, 1, 3),
    ),
    "failures add": Task(["failures", "add", "run", "--failures", "stored"], _failures, ("run", "walk.yaml")),
    "replay --export": Task(
        ["replay", "--run", "run", "--export", "r.csv", "--write-blob", "b"],
        lambda: Path("r.csv").read_text(), ("run",), codes=(0, 1),
    ),
    "monitor --out": Task(["monitor", "run", "--out", "m"], _texts("m/*.json"), ("run",), codes=(0, 1)),
    "monitor of many drives": Task(
        ["monitor", "drives", "--rule", "R_G1", "--out", "m"], _texts("m/*.*"), ("drives",), codes=(0, 1),
    ),
    "compare --out": Task(
        ["compare", "walk.yaml", "--specification", "near", "--estimators", "mc,ams", "--budget", "steps=400",
         "--set", "ams.particles=10", "--set", "ams.discard=2", "--repeat", "2", "--out", "c",
         "--no-pictures"],
        lambda: Path("c/comparison.md").exists(), ("walk.yaml",),
    ),
    "why --out": Task(
        ["why", "run", "--fresh", "20", "--out", "k", "--resume"], _texts("k/*.json"), ("run",),
    ),
    "sensitivity --out": Task(
        ["sensitivity", "walk.yaml", *_SCALE, "--budget", "rollouts=60", "--out", "k", "--resume"],
        _texts("k/*.json"), ("walk.yaml",),
    ),
    "require --out": Task(
        ["require", "walk.yaml", *_SCALE, "--probability", "< 0.1", "--budget", "rollouts=400",
         "--out", "k", "--resume"],
        _texts("k/*.json"), ("walk.yaml",), codes=(0, 3),
    ),
    "rate": Task(
        ["rate", "catalogue.yaml", "--quiet", "--out", "out"],
        lambda: _texts("out/rate.json")(), ("catalogue.yaml", "walk.yaml"),
        ["rate", "catalogue.yaml", "--quiet", "--out", "out", "--resume"], codes=(0, 3),
    ),
    "falsify": Task(
        ["falsify", "walk.yaml", "--specification", "near", "--budget", "rollouts=40", "--failures", "stored",
         "--write-blob", "b"],
        lambda: (_failures(), Path("b").read_text()), ("walk.yaml",), codes=(0, 1),
    ),
    "synthesise": Task(
        ["synthesise", "linear.yaml", "--parameter", "mean", "--steps", "1", "--chains", "10", "--runs", "2",
         "--out", "better"],
        lambda: Path("better/scenario.yaml").read_text(), ("linear.yaml",),
    ),
    "pem fit": Task(
        fits.FIT, lambda: Path("fitted/model.npz").read_bytes(), ("detections.csv",), prepare=fits.shorten,
    ),
    "pem convert": Task(
        ["pem", "convert", "vehicles.txt", "labels.txt", "--out", "made"],
        _texts("made/vehicles.csv"), ("vehicles.txt", "labels.txt"),
    ),
    "flow fit": Task(fits.FLOW, lambda: Path("fitted/samples.npz").read_bytes(), ("samples.npy",)),
    "policy convert": Task(
        ["policy", "convert", "policy.zip", "--out", "p"],
        lambda: Path("p/policy.npz").read_bytes(), ("policy.zip",),
    ),
    "new scenario": Task(
        ["new", "scenario", "first", "--simulator", "toy_walk"], lambda: Path("first.yaml").read_text(),
    ),
    "new plugin": Task(
        ["new", "plugin", "gusts", "--kind", "controller"],
        lambda: sorted(path.name for path in Path().rglob("*.*")),
    ),
}  # fmt: skip


def crash(task, point, home) -> tuple[bool, str | None, str]:
    """Kill a command at one point, then repeat it: (whether it was killed, trouble or None, what was told).

    ``point`` is the number of a call, or minus the place of a size in ``TORN`` minus one. ``home`` has
    ``material`` and is entered by ``material.inside``.
    """
    _fresh(task, home)
    with contextlib.chdir(home / "work"):
        code, leader = _killed(task.words, point, home / "log")
        if code >= 0:
            return False, None, ""
        found, told = (HANG, "its workers outlive it") if outlive(leader) else _mend(task, home)
    return True, found, f"avrare {' '.join(task.words)}, killed at point {point}\n{told}" if found else ""


def undisturbed(task, home):
    """Return what the command leaves when nothing happens."""
    _fresh(task, home)
    with contextlib.chdir(home / "work"):
        program = Program(task.words, home / "log")
        code = program.wait(_PATIENCE)
        assert code in task.codes, (code, (home / "log").read_text())
        return task.left()


def points(task, home, begin=(0, 0)):
    """Yield (point, trouble, told, where to go on) of each point at which the command could be killed.

    Every eighth call comes first, then those between, so that a short attack sees all of the command.
    """
    task.prepare()
    wanted = undisturbed(task, home)
    for i, order in enumerate(_ORDERS):
        for j, point in enumerate(order):
            if (i, j) < tuple(begin):
                continue
            killed, found, told = crash(task, point, home)
            if not killed and point >= 0:
                break
            if killed and found is None:
                with contextlib.chdir(home / "work"):
                    found = BITS if task.left() != wanted else None
                    told = f"avrare {' '.join(task.words)}, killed at point {point}" if found else ""
            if killed:
                yield point, found, told, (i, j + 1)


def _fresh(task, home):
    shutil.rmtree(home / "work", ignore_errors=True)
    (home / "work").mkdir()
    for need in task.needs:
        copy_material(home, need, home / "work")


def _killed(words, point, log):
    folder = os.getcwd()
    child = os.fork()
    if child:
        _, status = os.waitpid(child, 0)
        return os.waitstatus_to_exitcode(status), child
    code = 70
    try:
        os.setsid()
        warm_workers.use()
        sys.stdout = sys.stderr = io.StringIO()
        if point < 0:
            size = TORN[-point - 1]
            signal.signal(signal.SIGXFSZ, signal.SIG_DFL)
            resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))
        else:
            _kill_at(point, folder)
        from avrare.cli.main import main

        code = main(list(words))
    finally:
        os._exit(code)


def _kill_at(point, folder):
    left, victim, fsync = [point], os.getpid(), os.fsync

    def step():
        left[0] -= 1
        if left[0] < 0 and os.getpid() == victim:
            os.kill(os.getpid(), signal.SIGKILL)

    def watch(event, arguments):
        if (
            event not in CHANGES
            or not arguments
            or not os.path.abspath(os.fsdecode(_name(arguments[0]))).startswith(folder)
        ):
            return
        if event != "open" or (arguments[2] or 0) & (os.O_WRONLY | os.O_RDWR):
            step()

    def stopping(handle):
        step()
        fsync(handle)

    os.fsync = stopping
    sys.addaudithook(watch)


def _name(path):
    return path if isinstance(path, (str, bytes)) else "/"


def _mend(task, home):
    """Repeat the command as a user would; what is wrong with that, and what it said."""
    again = task.again if task.again is not None and Path("out").exists() else task.words
    code, text = _call(again, home)
    if code == 4 and again is not task.words and "contains no interrupted run" in text:
        if list(Path("out").rglob("*.npz")):
            return CODE, "chunks are there, but no run: " + text
        code, text = _call(task.words, home)
    if code is None:
        return HANG, text
    if "Traceback (most recent" in text or code == 70:
        return TRACEBACK, text
    if code not in task.codes:
        return CODE, f"exit code {code}: {text}"
    left = [path for path in Path().rglob("*") if path.name.startswith(".") and path.name.endswith(".tmp")]
    left += list(Path().rglob("checkpoint"))
    return (CODE, f"left behind: {left}") if left else (None, "")


def _call(words, home):
    program = Program(words, home / "log")
    code = program.wait(_PATIENCE)
    program.destroy()
    return code, (home / "log").read_text(errors="replace")
