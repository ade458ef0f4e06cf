"""Kills at random moments: whatever is done to a run, it ends in words, and resumes to the same bits."""

import contextlib
import functools
import importlib
import os
import shutil
import signal
import sys
import tempfile
import time
from dataclasses import dataclass
from multiprocessing import resource_tracker
from pathlib import Path

import numpy as np

from attack import warm_workers
from attack.attempts import BITS, CODE, HANG, TRACEBACK
from attack.material import ESTIMATORS, quietly, result, walk
from attack.mutation import pick
from avrare.cli.main import COMMANDS, main

PAUSE = "0.001"
"""Seconds of a step of the toy walk, so that signals arrive in the midst of chunks."""
PATIENCE = 90.0
"""Seconds after which a run is said to hang: a worker that is stopped is waited for, then replaced."""
SPAWNED = 0.1
"""Share of the runs with workers whose workers are spawned, as users' are; others are forked, and warm."""
KILLS = {
    "parent": [signal.SIGKILL, signal.SIGKILL, signal.SIGTERM, signal.SIGINT, signal.SIGSTOP],
    "worker": [signal.SIGKILL, signal.SIGKILL, signal.SIGTERM, signal.SIGINT, signal.SIGSTOP],
    "group": [signal.SIGKILL, signal.SIGTERM, signal.SIGINT, signal.SIGSTOP],
}
_ENDS = {signal.SIGKILL: {-9, 0}, signal.SIGTERM: {2, 0}, signal.SIGINT: {2, 0}, signal.SIGSTOP: {0}}
"""Signal to the parent or the group -> how the run may end; 0: it was at its end already."""


@dataclass(frozen=True)
class Life:
    """One run under attack: what was sent to whom, and how it ended (None: not within ``PATIENCE``)."""

    estimator: str
    target: str
    number: signal.Signals
    code: int | None
    told: str


class Program:
    """``avrare`` in a child of this process, which leads a process group of its own.

    ``warm``: it forks its workers, which need not import anything.
    """

    def __init__(self, words, log: Path, warm: bool = True) -> None:
        _import_all()
        ready, begun = os.pipe()
        self.pid = os.fork()
        if self.pid == 0:
            _be_program(words, log, begun, warm)
        os.close(begun)
        os.read(ready, 1)
        os.close(ready)

    def workers(self) -> list[int]:
        """Return the processes of the group beside its leader."""
        return workers(self.pid)

    def wait(self, seconds) -> int | None:
        """Return the exit code, minus the signal that ended it; None if it does not end."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            if pid:
                return os.waitstatus_to_exitcode(status)
            time.sleep(0.005)
        return None

    def destroy(self) -> None:
        """End whatever is left of the group."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.pid, signal.SIGKILL)


def workers(leader: int) -> list[int]:
    """Return the processes of a group beside its leader."""
    found = []
    for path in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError, ValueError, IndexError):
            fields = (path / "stat").read_text().rsplit(")", 1)[1].split()
            tracker = b"resource_tracker" in (path / "cmdline").read_bytes()
            ours = int(fields[2]) == leader != int(path.name)
            if ours and fields[0] != "Z" and not tracker:
                found.append(int(path.name))
    return found


def outlive(leader: int) -> bool:
    """Return whether workers are left 15 seconds after their parent has ended."""
    end = time.monotonic() + 15.0
    while workers(leader):
        if time.monotonic() > end:
            return True
        time.sleep(0.02)
    return False


_PICTURES = ("matplotlib.figure", "matplotlib.backends.backend_agg", "PIL.PngImagePlugin")


@functools.cache
def _import_all():
    """Import and start what the command does, so that no child has to."""
    resource_tracker.ensure_running()
    for module in (*(name for name, _ in COMMANDS.values()), *_PICTURES):
        with contextlib.suppress(ImportError):
            importlib.import_module(module)
    for estimator in ESTIMATORS:
        path = Path(tempfile.mkdtemp()) / "walk.yaml"
        path.write_text(walk(estimator))
        quietly("run", str(path), "--no-pictures", "--out", str(path.parent))
        shutil.rmtree(path.parent)


def _be_program(words, log, begun, warm):
    os.setsid()
    if warm:
        warm_workers.use()
    for number in (signal.SIGTERM, signal.SIGPROF, signal.SIGALRM):
        signal.signal(number, signal.SIG_DFL)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    file = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(file, 1)
    os.dup2(file, 2)
    sys.stdout, sys.stderr = os.fdopen(1, "w", closefd=False), os.fdopen(2, "w", closefd=False)
    code = 70
    try:
        os.write(begun, b".")
        code = main(list(words))
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


def whole(estimator, home):
    """Result of the undisturbed run, made once."""
    folder = home / "whole" / estimator
    if result(folder) is None:
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        (home / f"{estimator}.yaml").write_text(walk(estimator))
        program = Program([*_words(estimator, home, 1), "--out", str(folder), "--resume"], home / "log")
        assert program.wait(PATIENCE) == 0, (home / "log").read_text()
    return result(folder)


@functools.cache
def _duration(estimator, workers, warm, home):
    """Seconds of an undisturbed run."""
    with tempfile.TemporaryDirectory() as folder:
        begun = time.monotonic()
        program = Program(
            [*_words(estimator, home, workers), "--out", folder, "--resume"], home / "log", warm
        )
        assert program.wait(PATIENCE) == 0, (home / "log").read_text()
    return time.monotonic() - begun


def _words(estimator, home, workers):
    return ["run", str(home / f"{estimator}.yaml"), "--no-pictures", "--plain", "--workers", str(workers)]


def harass(seed, home):
    """Kill one run again and again until it is let end: (trouble or None, what was told, its lives).

    ``home`` is a folder of its own, entered by ``material.inside``.
    """
    random = np.random.default_rng([seed, 99])
    estimator = pick(random, list(ESTIMATORS))
    wanted = whole(estimator, home)
    folder = home / "torn"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    lives, found, told = [], None, ""
    os.environ["AVRARE_TOY_PAUSE"] = PAUSE
    while found is None and (not lives or (random.random() < 0.7 and result(folder) is None)):
        life, found = _live(random, estimator, home)
        lives.append(life)
    if found is None:
        program = Program([*_words(estimator, home, 1), "--out", str(folder), "--resume"], home / "log")
        code = program.wait(PATIENCE)
        program.destroy()
        found = HANG if code is None else CODE if code else None
        found = found or (BITS if result(folder) != wanted else None)
        found = found or (CODE if _leftovers(folder) else None)
        lives.append(Life(estimator, "nobody", signal.SIGCONT, code, (home / "log").read_text()[-1500:]))
    if found:
        told = f"{estimator}\n" + "\n".join(
            f"{one.number.name} of {one.target}: {one.code}\n{one.told}" for one in lives
        )
    return found, told, lives[: len(lives) - (lives[-1].target == "nobody")]


def _live(random, estimator, home):
    log = home / "log"
    workers = int(random.integers(1, 3))
    target = pick(random, ["parent", "group", "worker", "worker"][: 2 + workers])
    target = target if workers == 2 or target != "worker" else "parent"
    number = pick(random, KILLS[target])
    warm = workers == 1 or random.random() >= SPAWNED
    program = Program([*_words(estimator, home, workers), "--out", str(home / "torn"), "--resume"], log, warm)
    time.sleep(float(random.uniform(0.0, _duration(estimator, workers, warm, home))))
    _send(program, target, number, random)
    code = program.wait(PATIENCE)
    left = outlive(program.pid)
    program.destroy()
    if code is None:
        os.waitpid(program.pid, 0)
    text = log.read_text(errors="replace")
    life = Life(estimator, target, number, code, text[-1500:])
    allowed = {0} if target == "worker" else _ENDS[number]
    if code is None or left:
        return life, HANG
    if "Traceback (most recent" in text or "bug in avrare" in text:
        return life, TRACEBACK
    return life, None if code in allowed else CODE


def _send(program, target, number, random):
    with contextlib.suppress(ProcessLookupError):
        if target == "parent":
            os.kill(program.pid, number)
        elif target == "group":
            os.killpg(program.pid, number)
        else:
            for pid in program.workers()[: int(random.integers(1, 3))]:
                os.kill(pid, number)
        if number == signal.SIGSTOP and (target != "worker" or random.random() < 0.7):
            time.sleep(float(random.uniform(0.05, 0.8)))
            os.killpg(program.pid, signal.SIGCONT)


def _leftovers(folder):
    return [path for path in folder.rglob("*") if path.name.startswith(".") or path.name == "checkpoint"]
