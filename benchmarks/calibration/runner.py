"""Runner: makes cells one after the other, each in a worker of its tool's environment."""

from __future__ import annotations

import contextlib
import json
import os
import selectors
import subprocess
import time
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from benchmarks.calibration import cells
from benchmarks.calibration.environments import interpreter
from benchmarks.calibration.tools import TOOLS, Tool

ROOT = Path(__file__).parents[2]
_START = 60.0
"""CPU seconds that a new worker may take to import its tool."""
_CROWDED = 20.0
"""Wall seconds for each CPU second after which an answer is given up all the same."""


class Runner:
    """Maker of cells, with a worker for each environment, started when it is needed.

    Args:
        folder: Of the cells.
        limit: CPU seconds of the worker after which an answer is given up.
        hopeless: Questions whose first seed was given up, to which it adds: their other seeds are not asked.
        seconds: CPU seconds that the first seed of a question took: ten times its budget is not asked where
            that would take five times as long, and so too long.
    """

    def __init__(
        self, folder: Path, limit: float, hopeless: set[cells.Question] | None = None,
        seconds: Mapping[cells.Question, float] | None = None,
    ) -> None:  # fmt: skip
        self.folder, self.limit, self.seconds = folder, limit, seconds or {}
        self.hopeless: set[cells.Question] = set() if hopeless is None else hopeless
        self.workers: dict[str, subprocess.Popen[str]] = {}
        self.versions: dict[str, str] = {}

    def run(self, keys: Iterable[cells.Key], end: float) -> None:
        """Make the cells of these keys until the monotonic clock shows ``end``."""
        try:
            for key in keys:
                if time.monotonic() > end:
                    break
                cell = self.cell(key)
                if cell.hopeless:
                    self.hopeless.add(cell.question)
                cells.add(self.folder, cell)
        finally:
            for worker in self.workers.values():
                _stop(worker)

    def cell(self, key: cells.Key) -> cells.Cell:
        """Return the cell of a key; a worker that dies or takes too long has no answer."""
        environment = TOOLS[key[0]].environment
        task = dict(zip(("tool", "setting", "problem", "budget", "seed"), key, strict=True))
        tool, setting, problem, budget, seed = key
        slow = self.seconds.get((tool, setting, problem, budget // 10))
        if slow is not None and cells.PACE * slow >= self.limit:
            return _without_answer(task, self.versions.get(environment, ""), 0.0, cells.Cell.too_slow(slow))
        if key[:-1] in self.hopeless and seed > 0:
            return _without_answer(
                task, self.versions.get(environment, ""), 0.0, cells.Cell.not_asked(self.limit)
            )
        line = "ready\n" if environment in self.workers else self._start(TOOLS[key[0]])
        worker = self.workers[environment]
        before = _cpu(worker.pid)
        if line:
            line = _ask(worker, json.dumps(task), self.limit)
        if line:
            fields: dict[str, Any] = json.loads(line)
            self.versions[environment] = fields["version"]
            return cells.Cell(**{**fields, "warnings": tuple(fields["warnings"])})
        seconds = _cpu(worker.pid) - before
        _stop(self.workers.pop(environment))
        if line == "":
            reason = "its process ended"
        elif seconds < self.limit:
            wall = _CROWDED * self.limit
            reason = f"it hung: no answer within {wall:.0f} seconds, {seconds:.0f} of them CPU"
        else:
            reason = cells.Cell.out_of_time(self.limit)
        return _without_answer(task, self.versions.get(environment, ""), seconds, reason)

    def _start(self, tool: Tool) -> str | None:
        """Start a worker; return its first line, "" where it died, None where it is not ready in time."""
        # Only the environment of the benchmark itself sees avrare's paths.
        environment = tool.environment
        inherited = os.environ.get("PYTHONPATH", "") if environment == "here" else ""
        paths = os.pathsep.join(filter(None, (str(ROOT), inherited)))
        worker = subprocess.Popen(
            [str(interpreter(environment)), "-m", "benchmarks.calibration.worker", tool.module],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
            env={**os.environ, "PYTHONPATH": paths},
        )  # fmt: skip
        self.workers[environment] = worker
        return _wait(worker, _START)


def _without_answer(task: Mapping[str, Any], version: str, seconds: float, reason: str) -> cells.Cell:
    return cells.Cell(
        **task, version=version, estimate=None, low=None, high=None, warnings=(), evaluations=0.0,
        seconds=round(seconds, 1), reason=reason,
    )  # fmt: skip


def _ask(worker: subprocess.Popen[str], task: str, limit: float) -> str | None:
    """Return the worker's line, "" where it died, None where the time is over."""
    assert worker.stdin
    try:
        print(task, file=worker.stdin, flush=True)
    except BrokenPipeError:
        return ""
    return _wait(worker, limit)


def _wait(worker: subprocess.Popen[str], limit: float) -> str | None:
    """Return the worker's next line, "" where it died, None where the time is over."""
    assert worker.stdout
    spent, end = _cpu(worker.pid), time.monotonic() + _CROWDED * limit
    with selectors.DefaultSelector() as selector:
        selector.register(worker.stdout, selectors.EVENT_READ)
        while not selector.select(min(limit, 1.0)):
            if _cpu(worker.pid) - spent >= limit or time.monotonic() >= end:
                return None
        return worker.stdout.readline()


def _cpu(pid: int) -> float:
    """Return the CPU seconds of a process; where the system does not tell, the clock's."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rsplit(")", 1)[1].split()
    except OSError:
        return time.monotonic()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _stop(worker: subprocess.Popen[str]) -> None:
    worker.kill()
    worker.wait()
    for stream in (worker.stdin, worker.stdout):
        if stream:
            with contextlib.suppress(BrokenPipeError):  # what a dead worker has not read
                stream.close()
