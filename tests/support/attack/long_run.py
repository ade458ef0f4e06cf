"""Long attack: resumable, its progress one file; children do the work, so that nothing ends it."""

import contextlib
import json
import os
import select
import shutil
import signal
import subprocess
import time
from collections import Counter
from pathlib import Path

import avrare
from attack import crash_points, kills, material
from attack.attempts import HANG, LONGEST, TRACEBACK, TROUBLES, limit_memory
from attack.kinds import KINDS, attempt
from avrare.base.atomic_files import write_text

_BATCH, _KILLED, _CRASHED = 100, 3, 8
"""Inputs of a kind, runs that are killed, and crash points of a turn."""
_SILENCE = 8 * LONGEST
"""Seconds without an answer after which a child is ended; before that its own watch ends what it does."""
PARTS = ("inputs", "kills", "crash points")
_MOST_KEPT = 200
"""Findings of one kind that are kept with what was told."""


class Progress:
    """File with what comes next, the counts of each version of the code, and what was found, with its seed.

    Inputs and kills go on where an earlier version stopped; crash points begin again with each version.
    """

    def __init__(self, path: Path, version: str) -> None:
        self.path, self.version = path, version
        self.content = {"next": {part: {} for part in PARTS}, "versions": {}, "found": []}
        if path.exists():
            self.content = json.loads(path.read_text())
        if version not in self.content["versions"]:
            self.content["versions"][version] = {part: {} for part in PARTS}
            self.content["next"]["crash points"] = {}

    def following(self, part, name):
        """Return what comes next of a kind: a seed, or a place among crash points; None: all is done."""
        return self.content["next"][part].get(name, 0)

    def proceed(self, part, name, following):
        """Set what comes next."""
        self.content["next"][part][name] = following

    def add(self, part, name, seed, trouble, told):
        """Count one attempt."""
        counts = self.content["versions"][self.version][part]
        entry = counts.setdefault(name, {"tried": 0, **dict.fromkeys(TROUBLES, 0)})
        entry["tried"] += 1
        if trouble:
            entry[trouble] += 1
            found = {"version": self.version, "part": part, "kind": name, "seed": seed, "trouble": trouble}
            if sum(one["kind"] == name for one in self.content["found"]) < _MOST_KEPT:
                self.content["found"].append(found | {"told": told[-3000:]})
            print(f"{name}, seed {seed}: {trouble}\n{told[-1200:]}", flush=True)

    def save(self):
        """Write the file."""
        write_text(self.path, json.dumps(self.content, indent=1))

    def table(self) -> str:
        """Counts by kind, of each version that tried it and of all, in Markdown."""
        versions = self.content["versions"]
        head = [part for version in [*versions, "all"] for part in (version, "found")]
        lines = [["", *head], ["---", *["---:"] * len(head)]]
        for part in PARTS:
            for name in dict.fromkeys(name for counts in versions.values() for name in counts[part]):
                lines.append([name, *_cells([counts[part].get(name) for counts in versions.values()])])
        totals = [_total(counts) for counts in versions.values()]
        lines.append(["**all**", *_cells(totals)])
        return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"


def _total(counts):
    total = Counter()
    for entry in (entry for part in counts.values() for entry in part.values()):
        total.update(entry)
    return total


def _cells(entries):
    pairs = [(one["tried"], sum(one[trouble] for trouble in TROUBLES)) if one else (0, 0) for one in entries]
    pairs.append(tuple(map(sum, zip(*pairs, strict=True))))
    return [f"{number:,}" if pair[0] else "" for pair in pairs for number in pair]


def version() -> str:
    """Name the version of the code that is attacked, and whether it has changes that no commit has."""
    words = ["git", "-C", str(material.ROOT), "describe", "--always", "--dirty"]
    with contextlib.suppress(OSError):
        told = subprocess.run(words, capture_output=True, text=True, check=False).stdout.strip()
        if told:
            return told
    return avrare.__version__


def run(folder: Path, inputs: int, many_kills: int, only, seconds: float) -> Progress:
    """Go on with an attack until all is tried or the time is over, and return its progress."""
    folder.mkdir(parents=True, exist_ok=True)
    end = time.monotonic() + seconds
    progress = Progress(folder / "progress.json", version())
    if not any(progress.content["versions"][progress.version].values()):
        shutil.rmtree(folder / "material", ignore_errors=True)  # results of an earlier version are no measure
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
    while (first := progress.following("inputs", name)) < inputs:
        for seed, trouble, told in _batch(folder, name, range(first, min(inputs, first + _BATCH))):
            progress.add("inputs", name, seed, trouble, told)
            progress.proceed("inputs", name, seed + 1)
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
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    while progress.following("kills", "kills") < most:
        seed = progress.following("kills", "runs")
        trouble, told, lives = kills.harass(seed, folder)
        for i, life in enumerate(lives):
            name = f"kills of `{life.estimator}`: {life.number.name} of the {life.target}"
            last = i == len(lives) - 1
            progress.add("kills", name, seed, trouble if last else None, told)
        progress.proceed("kills", "runs", seed + 1)
        progress.proceed("kills", "kills", progress.following("kills", "kills") + len(lives))
        if seed % _KILLED == _KILLED - 1:
            yield True


def _crash_points(progress, folder, name):
    begin = progress.following("crash points", name)
    if begin is None:
        return
    home, task = folder / "crashes", crash_points.TASKS[name]
    home.mkdir(exist_ok=True)
    for count, (point, trouble, told, following) in enumerate(
        crash_points.points(task, home, begin or (0, 0))
    ):
        progress.add("crash points", f"crash points of `{name}`", point, trouble, told)
        progress.proceed("crash points", name, following)
        if count % _CRASHED == _CRASHED - 1:
            yield True
    progress.proceed("crash points", name, None)
    yield True
