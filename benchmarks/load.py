"""Load table of docs/limits.md: large inputs, each a command in a process of its own, with time and memory.

python benchmarks/load.py            # all rows, some ten CPU minutes
python benchmarks/load.py workers    # the rows whose name contains a word; the page is left alone
"""

from __future__ import annotations

import json
import os
import shlex
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np

from avrare.analysis.history.entry import HistoryEntry
from avrare.analysis.history.store import HistoryStore

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "limits.md"
BEGIN, END = "<!-- load: begin -->", "<!-- load: end -->"
WALK = """\
name: walk
steps: 20
simulator:
  {plugin: linear, states: [x], A: [[1]], process_noise: [0.01], initial: {mean: [0], covariance: [0.01]}}
specifications: {low: {stl: "always (x < LIMIT)"}}
"""


@dataclass(frozen=True)
class Row:
    """A load: its files, and the command that meets them."""

    name: str
    command: str
    prepare: Callable[[Path], None]


def _walk(limit: float) -> Callable[[Path], None]:
    return lambda folder: _write(folder / "walk.yaml", WALK.replace("LIMIT", str(limit)))


def _write(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8")


def _lane_change(folder: Path, text: str) -> None:
    for name in ("lane_change.yaml", "_base/highway.yaml"):
        (folder / name).parent.mkdir(exist_ok=True)
        _write(folder / name, (ROOT / "scenarios" / name).read_text(encoding="utf-8"))
    _write(folder / "large.yaml", f"extends: lane_change.yaml\nname: large\n{text}\n")


def _specifications(count: int) -> Callable[[Path], None]:
    lines = [f"  s{k}: {{stl: 'always (gap > {-5 - 0.01 * k:.2f})'}}" for k in range(count)]
    return lambda folder: _lane_change(folder, "\n".join(["specifications:", *lines]))


def _vehicles(count: int) -> Callable[[Path], None]:
    lanes = (-1.75, 1.75, 5.25)
    lines = [
        f"    - {{name: v{k}, x: {100 + 20 * (k // 3)}, y: {lanes[k % 3]}, speed: {20 + k % 5}}}"
        for k in range(count)
    ]
    return lambda folder: _lane_change(folder, "\n".join(["simulator:", "  vehicles:", *lines]))


def _failures(folder: Path) -> None:
    _walk(0.5)(folder)
    words = "run walk.yaml --out run --no-pictures --quiet --set chunk=1000 --set estimator.rollouts=20000"
    subprocess.run(["avrare", *words.split()], cwd=folder, check=True, capture_output=True)
    arrays = dict(np.load(folder / "run" / "failures.npz"))
    chosen = np.arange(10_000) % len(arrays["low.robustness"])
    arrays |= {f"low.{name}": arrays[f"low.{name}"][chosen] for name in ("noise", "robustness")}
    np.savez(folder / "run" / "failures.npz", **arrays)


def _history(folder: Path) -> None:
    begin = datetime(2026, 1, 1, tzinfo=UTC)
    entries = [
        HistoryEntry(
            f"{k:032x}", (begin + timedelta(hours=k)).isoformat(), f"{k:040x}", False, "night", "f" * 16,
            f"rule_{k % 3}", "mc", 0, 0.1, 0.05, 0.2, 0.95, 1000, 40_000, 100, 0, 60.0, "", "pass",
        )
        for k in range(5000)
    ]  # fmt: skip
    with HistoryStore(str(folder / "history.sqlite"), create=True) as store:
        store.add(entries)


def _formula(folder: Path) -> None:
    doubled = "".join(f"a{k} = {'x < 9' if not k else f'a{k - 1} and a{k - 1}'}; " for k in range(20))
    _write(folder / "walk.yaml", WALK.replace("always (x < LIMIT)", f"{doubled}always a19"))


RUN = "run {} --quiet --no-pictures --out out"
LARGE, SMALL = RUN.format("large.yaml"), RUN.format("walk.yaml")
AMS = f"{SMALL} --estimator ams --set estimator.runs=1"
MILLION = "--set estimator.particles=1e6 --set estimator.discard=2e5 --set chunk=50000 --set steps=10"
ROWS = (
    Row("200 specifications, 25 rollouts", f"{LARGE} --set estimator.rollouts=25", _specifications(200)),
    Row("50 vehicles, 25 rollouts", f"{LARGE} --set estimator.rollouts=25", _vehicles(50)),
    Row(
        "10,000 steps, 100 rollouts",
        f"{SMALL} --set steps=10000 --set estimator.rollouts=100 --set chunk=100",
        _walk(8.0),
    ),
    Row("1,000,000 particles", f"{AMS} {MILLION}", _walk(0.9)),
    Row("1,000,000 particles, `memory: 1024`", f"{AMS} {MILLION} --set estimator.memory=1024", _walk(0.9)),
    Row("64 workers, 64 chunks", f"{SMALL} --workers 64 --set estimator.rollouts=1600", _walk(0.9)),
    Row("10,000 failures in a report", "report run", _failures),
    Row("5,000 history entries, all shown", "history --limit 0 --store history.sqlite", _history),
    Row("1,000,000,000 particles", f"{AMS} --set estimator.particles=1e9", _walk(0.9)),
    Row("1,000,000 particles, `memory: 100`", f"{AMS} {MILLION} --set estimator.memory=100", _walk(0.9)),
    Row("1,005 specifications", "validate large.yaml", _specifications(1000)),
    Row("1,001 vehicles", "validate large.yaml", _vehicles(1001)),
    Row(
        "a schedule of 100,000,000 steps",
        "validate large.yaml --set simulator.vehicles.1.drive.schedule.1.to_step=1e8",
        lambda folder: _lane_change(folder, ""),
    ),
    Row("100,000,000 steps", "validate walk.yaml --set steps=1e8", _walk(0.9)),
    Row("1,025 workers", f"{SMALL} --workers 1025", _walk(0.9)),
    Row("a formula of 1,000,000 parts", "validate walk.yaml", _formula),
)


def measure(row: Row) -> dict[str, Any]:
    """Run a row; return its seconds, the peak of the memory of all its processes, exit code and words."""
    with tempfile.TemporaryDirectory() as name:
        row.prepare(folder := Path(name))
        with (folder / "words").open("w+b") as words:
            begin, before, peak = time.perf_counter(), os.times(), 0
            process = subprocess.Popen(
                ["avrare", *shlex.split(row.command)], cwd=folder, stdout=words, stderr=subprocess.STDOUT,
                start_new_session=True,
            )  # fmt: skip
            while process.poll() is None:
                peak = max(peak, sum(_resident(process.pid)))
                time.sleep(0.05)
            after = os.times()
            words.seek(0)
            told = words.read().decode().strip().splitlines()
    return {
        "name": row.name, "seconds": time.perf_counter() - begin, "memory": peak, "code": process.returncode,
        "cpu": after.children_user + after.children_system - before.children_user - before.children_system,
        "told": " ".join(told[-2:] if process.returncode else told[-1:]),
    }  # fmt: skip


def _resident(session: int) -> Iterator[int]:
    page = os.sysconf("SC_PAGE_SIZE")
    for entry in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = entry.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(fields[3]) == session:
            yield int(fields[21]) * page


def render(found: list[dict[str, Any]]) -> str:
    """Return the load table and the table of refusals as Markdown."""
    lines = ["| load | CPU time | memory |", "|---|---|---|"]
    lines += [
        f"| {one['name']} | {one['cpu']:.0f} s | {one['memory'] / 2**20:,.0f} MiB |"
        for one in found
        if not one["code"]
    ]
    lines += ["", "| refused | after | words |", "|---|---|---|"]
    lines += [
        f"| {one['name']} | {one['cpu']:.1f} s | {_words(str(one['told']))} |" for one in found if one["code"]
    ]
    return "\n".join(lines)


def _words(told: str) -> str:
    message, _, hint = told.partition(" hint: ")
    return f"{message.rpartition('.yaml: ')[2]}" + (f"; *{hint}*" if hint else "")


def main() -> None:
    """Measure the rows, print them, and write the page if all were measured."""
    wanted = sys.argv[1:]
    found: list[dict[str, Any]] = []
    for row in ROWS:
        if not wanted or any(word in row.name for word in wanted):
            found.append(measure(row))
            print(json.dumps(found[-1]), flush=True)
    if not wanted:
        text = PAGE.read_text(encoding="utf-8")
        head, rest = text.split(BEGIN)
        _write(PAGE, f"{head}{BEGIN}\n{render(found)}\n{END}{rest.split(END)[1]}")


if __name__ == "__main__":
    main()
