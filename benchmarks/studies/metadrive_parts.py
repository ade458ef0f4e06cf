"""Estimates in parts, each with a seed of its own: a file for each estimator, to which more may be added."""

from __future__ import annotations

import json
import statistics
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import avrare
from avrare.estimation.result import intervals
from avrare.rollout.problem import Problem
from avrare_estimators.common import health

Part = dict[str, Any]
Clock = Callable[[], float]
SCENARIO = "scenario"
"""Key of the scenario's fingerprint among the options of a part: no option, but must be equal as well."""
CONFIDENCE = 0.95


def run(
    problem: Problem, name: str, options: Mapping[str, Any], count: int, folder: Path, clock: Clock
) -> None:
    """Run the parts that ``NAME.jsonl`` lacks.

    Part k has seed k, and keeps its failing tapes in ``NAME-k.npz``. One that was interrupted goes on from
    its last chunk, until which its CPU time was counted.

    Args:
        problem: What is estimated.
        name: Of the estimator.
        options: Of the estimator, for each part.
        count: Parts that there shall be.
        folder: Of the results.
        clock: CPU time until now [s].
    """
    folder.mkdir(parents=True, exist_ok=True)
    known = {part["seed"] for part in read(folder, name, options)}
    for seed in sorted(set(range(count)) - known):
        part = {"seed": seed, "options": dict(options)} | _run_part(
            problem, name, options, seed, folder, clock
        )
        with (folder / f"{name}.jsonl").open("a") as file:
            file.write(json.dumps(part) + "\n")
        (folder / f"{name}-{seed}.cpu").unlink(missing_ok=True)
        print(name, seed, part["run_probabilities"], part["failures"], f"{part['cpu']:.0f} s", flush=True)


def _run_part(
    problem: Problem, name: str, options: Mapping[str, Any], seed: int, folder: Path, clock: Clock
) -> Part:
    begin, spent = clock(), folder / f"{name}-{seed}.cpu"
    before = float(spent.read_text()) if spent.exists() else 0.0

    def note(_: Any) -> None:
        spent.write_text(repr(before + clock() - begin))

    given = {key: value for key, value in options.items() if key != SCENARIO}
    chunks = folder / f"{name}-{seed}-chunks"
    result = avrare.estimate(problem, name, seed=seed, checkpoint=chunks, progress=note, **given)
    noise, ancestors = result.failures.noise, result.failures.ancestors
    ancestors = np.zeros((len(noise), 2), dtype=np.int64) if ancestors is None else ancestors
    np.savez(folder / f"{name}-{seed}.npz", noise=noise, ancestors=ancestors)
    found: Part = json.loads(result.to_json())
    return found | {"cpu": before + clock() - begin}


def read(folder: Path, name: str, options: Mapping[str, Any]) -> list[Part]:
    """Return the finished parts.

    Raises:
        ValueError: They were made with other options, or from another scenario.
    """
    path = folder / f"{name}.jsonl"
    parts = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []
    if any(part["options"] != options for part in parts):
        raise ValueError(f"{path} has parts with other options than {dict(options)}: move it away")
    return parts


def pool(parts: Sequence[Part]) -> tuple[float, tuple[float, float], list[str]]:
    """Return probability, interval and warnings of all parts together.

    Monte Carlo adds its counts up; the runs of the others stand beside each other.
    """
    if parts[0]["estimator"] == "mc":
        failures, trials = (sum(part[key] for part in parts) for key in ("failures", "rollouts"))
        errors = sum(part["errors"] for part in parts)
        found = intervals.clopper_pearson(failures, trials, CONFIDENCE, errors)
        return failures / trials, found, []
    values = [value for part in parts for value in part["run_probabilities"]]
    roots = [count for part in parts for count in part["diagnostics"]["roots"]]
    warnings = list(health.check_runs(values, roots))
    mean = statistics.fmean(values)
    if len(values) < 2 or not mean:
        return mean, (parts[0]["interval"][0], parts[0]["interval"][1]), warnings
    relative = statistics.variance(values) / mean**2 / len(values)
    logs = intervals.cox(values)
    found = intervals.log_normal(mean, relative, CONFIDENCE, freedom=len(values) - 1, logs=logs)
    return mean, found, warnings


def table(folder: Path, options: Mapping[str, Mapping[str, Any]]) -> str:
    """Return a row for each estimator that has finished parts."""
    lines = [
        "| estimator | a part | parts | probability | 95 % interval | rollouts | steps | CPU | health |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for name, chosen in options.items():
        if not (parts := read(folder, name, chosen)):
            continue
        p, (low, high), warnings = pool(parts)
        rollouts, steps, cpu = (
            sum(part[key] for part in parts) for key in ("rollouts", "simulated_steps", "cpu")
        )
        told = ", ".join(f"{key} {value}" for key, value in chosen.items() if key != SCENARIO)
        lines.append(
            f"| `{name}` | {told} | {len(parts)} | {p:.2e} | {low:.1e} to {high:.1e} "
            f"| {rollouts:,} | {steps:,} | {cpu / 60:.1f} min | {', '.join(warnings) or '-'} |"
        )
    return "\n".join(lines)
