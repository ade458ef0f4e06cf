"""Worker: answers tasks from its standard input with lines of JSON; it runs in the environment of a tool.

    python -m benchmarks.calibration.worker ADAPTER

It writes an empty line when the adapter is imported. A task is a line of JSON with the fields of a ``Cell``
that make its key. The tool's own output goes nowhere.
"""

from __future__ import annotations

import importlib
import json
import os
import resource
import sys
import time
from dataclasses import asdict
from typing import Any

from benchmarks.calibration.answer import Counted, NoAnswerError
from benchmarks.calibration.cells import Cell
from benchmarks.calibration.problems import problems
from benchmarks.calibration.tools import TOOLS

MEMORY = 6 * 2**30
"""Bytes that a worker may take: one that takes all of the machine's would end the workers beside it."""


def run(task: dict[str, Any]) -> Cell:
    """Return the cell of a task."""
    tool = TOOLS[task["tool"]]
    adapter = importlib.import_module(tool.module)
    counted = Counted(problems()[task["problem"]], task["budget"])
    options = dict(tool.settings[task["setting"]])
    began, answer, reason = time.process_time(), None, ""
    try:
        answer = adapter.estimate(tool.method, counted, task["budget"], task["seed"], options)
    except NoAnswerError as error:
        reason = str(error)
    except MemoryError:
        reason = f"it needs more than {MEMORY / 2**30:.0f} GiB of memory"
    low, high = answer.interval if answer and answer.interval else (None, None)
    return Cell(
        **task, version=adapter.tool_version(), estimate=answer.probability if answer else None, low=low,
        high=high, warnings=answer.warnings if answer else (), evaluations=round(counted.evaluations, 2),
        seconds=round(time.process_time() - began, 3), reason=reason,
    )  # fmt: skip


def main() -> None:
    """Answer until the input ends."""
    resource.setrlimit(resource.RLIMIT_DATA, (MEMORY, MEMORY))
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    silence = os.open(os.devnull, os.O_WRONLY)
    os.dup2(silence, 1)
    importlib.import_module(sys.argv[1])
    print(file=answers, flush=True)
    for line in sys.stdin:
        print(json.dumps(asdict(run(json.loads(line)))), file=answers, flush=True)


if __name__ == "__main__":
    main()
