"""Long attack: resumable, its progress one file; children do the work, so that nothing ends it."""

import contextlib
import json
import os
import select
import shutil
import signal
import time
from collections import Counter
from pathlib import Path

from attack import crash_points, kills, material
from attack.attempts import HANG, LONGEST, TRACEBACK, TROUBLES, limit_memory
from attack.kinds import KINDS, attempt
from avrare.base.atomic_files import write_text

_BATCH, _KILLED, _CRASHED = 100, 3, 8
"""Inputs of a kind, runs that are killed, and crash points of a turn."""
_SILENCE = 8 * LONGEST
"""Seconds without an answer after which a child is ended; before that its own watch ends what it does."""
_MOST_KEPT = 200
"""Findings of one kind that are kept with what was told."""


class Progress:
    """File with the counts so far, what comes next of each kind, and what was found, with its seed."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.content = {"kinds": {}, "kills": {}, "crash points": {}, "found": []}
        if path.exists():
            self.content = json.loads(path.read_text())

    def entry(self, part, name):
        """Counts of a kind of inputs, kills or crash points."""
        return self.content[part].setdefault(name, {"next": 0, "tried": 0, **dict.fromkeys(TROUBLES, 0)})

    def add(self, part, name, seed, trouble, told, following=None):
        """Count one attempt."""
        entry = self.entry(part, name)
        entry["next"], entry["tried"] = seed + 1 if following is None else following, entry["tried"] + 1
        if trouble:
            entry[trouble] += 1
            found = {"part": part, "kind": name, "seed": seed, "trouble": trouble, "told": told[-3000:]}
            if sum(one["kind"] == name for one in self.content["found"]) < _MOST_KEPT:
                self.content["found"].append(found)
            print(f"{name}, seed {seed}: {trouble}\n{told[-1200:]}", flush=True)

    def save(self):
        """Write the file."""
        write_text(self.path, json.dumps(self.content, indent=1))

    def table(self) -> str:
        """Counts by kind, in Markdown."""
        head = ["", "tried", *TROUBLES]
        lines = [head, ["---", *["---:"] * (len(head) - 1)]]
        for part in ("kinds", "kills", "crash points"):
            rows = self.content[part]
            lines += [[name, *(f"{entry[key]:,}" for key in head[1:])] for name, entry in rows.items()]
        total = Counter()
        for part in ("kinds", "kills", "crash points"):
            for entry in self.content[part].values():
                total.update({key: entry[key] for key in head[1:]})
        lines.append(["**all**", *(f"{total[key]:,}" for key in head[1:])])
        return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"


def run(folder: Path, inputs: int, many_kills: int, only, seconds: float) -> Progress:
    """Go on with an attack until all is tried or the time is over, and return its progress."""
    folder.mkdir(parents=True, exist_ok=True)
    end = time.monotonic() + seconds
    progress = Progress(folder / "progress.json")
    with material.inside(folder):
        for name in only or KINDS:  # so that no child has to import what all of them need
            if name in KINDS:
                attempt(name, 0, folder)
        turns = [*_inputs(progress, folder, inputs, only)]
        if not only or "kills" in only:
            turns.append(_kills(progress, folder / "kills", many_kills))
        if not only or "crash points" in only:
            turns += [_crash_points(progress, folder, name) for name in crash_points.TASKS]
        while turns and time.monotonic() < end:  # in turn, so that a short run tries some of everything
            turns = [turn for turn in turns if _take(turn, progress, end)]
    return progress


def _take(turn, progress, end) -> bool:
    """Let a part of the attack do some of its work; whether there is more of it."""
    more = time.monotonic() < end and next(turn, False)
    progress.save()
    write_text(progress.path.with_name("table.md"), progress.table())
    return more


def _inputs(progress, folder, inputs, only):
    for name in KINDS:
        if not only or name in only:
            yield _one_kind(progress, folder, name, inputs)


def _one_kind(progress, folder, name, inputs):
    while (first := progress.entry("kinds", name)["next"]) < inputs:
        for seed, trouble, told in _batch(folder, name, range(first, min(inputs, first + _BATCH))):
            progress.add("kinds", name, seed, trouble, told)
        yield True


def _batch(folder, name, seeds):
    """Yield (seed, trouble, told) of all, by a child that is replaced if it dies or falls silent."""
    while len(seeds):
        answers, theirs = os.pipe()
        child = os.fork()
        if child == 0:
            _serve(theirs, folder, name, seeds)
        os.close(theirs)
        with os.fdopen(answers) as lines:
            ended = HANG
            while select.select([lines], [], [], _SILENCE)[0]:
                line = lines.readline()
                if not line:
                    ended = TRACEBACK
                    break
                yield json.loads(line)
                seeds = seeds[1:]
        with contextlib.suppress(ProcessLookupError):
            os.kill(child, signal.SIGKILL)
        _, status = os.waitpid(child, 0)
        if len(seeds):
            yield seeds[0], ended, f"the process ended with {os.waitstatus_to_exitcode(status)}"
            seeds = seeds[1:]


def _serve(theirs, folder, name, seeds):
    try:
        limit_memory()
        with os.fdopen(theirs, "w", buffering=1) as answers, open(os.devnull) as nothing:
            os.dup2(nothing.fileno(), 0)
            for seed in seeds:
                try:
                    answer = attempt(name, seed, folder)
                except Exception as error:
                    answer = TRACEBACK, f"the attack itself failed: {error!r}"
                answers.write(json.dumps([seed, *answer]) + "\n")
    finally:
        os._exit(0)


def _kills(progress, folder, most):
    shutil.rmtree(folder, ignore_errors=True)  # results of an earlier version are no measure
    folder.mkdir()
    entries = progress.content["kills"]
    while sum(entry["tried"] for entry in entries.values()) < most:
        seed = max([entry["next"] for entry in entries.values()], default=0)
        trouble, told, lives = kills.harass(seed, folder)
        for i, life in enumerate(lives):
            name = f"{life.number.name} of the {life.target}"
            last = i == len(lives) - 1
            progress.add("kills", name, seed, trouble if last else None, told)
        if seed % _KILLED == _KILLED - 1:
            yield True


def _crash_points(progress, folder, name):
    entry = progress.entry("crash points", name)
    if entry.get("complete"):
        return
    home, task = folder / "crashes", crash_points.TASKS[name]
    home.mkdir(exist_ok=True)
    begin = entry["next"] or (0, 0)
    for count, (point, trouble, told, following) in enumerate(crash_points.points(task, home, begin)):
        progress.add("crash points", name, point, trouble, told, following)
        if count % _CRASHED == _CRASHED - 1:
            yield True
    entry["complete"] = True
    yield True
