"""Numbers that must not change: every estimator on a tiny problem, and the scenarios, of two checkouts.

    python benchmarks/golden.py                      # this checkout: all cases, each in three ways
    python benchmarks/golden.py --against a2a16cb    # and that commit: every difference is named
    python benchmarks/golden.py --only 'ams*'        # some of the cases

A case runs with one worker, with two, and once more killed (SIGKILL) and resumed; the three must agree
bit for bit. Results of a clean checkout stay in benchmarks/results/golden, so that a commit runs once on a
machine. The exit code is 1 if a difference is not in ``ACCEPTED``.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path

import numpy as np
import yaml

ROOT = Path(__file__).parents[1]
STORED_RESULTS = ROOT / "benchmarks" / "results" / "golden"
SAVED_FILES_BEFORE_KILL = 5
WAYS = ("one worker", "two workers", "resumed")
FIELDS = (
    "estimator",
    "probability",
    "interval",
    "blind_bound",
    "run_probabilities",
    "rollouts",
    "simulated_steps",
    "failures",
    "errors",
    "counts",
    "health",
)
ACCEPTED: dict[tuple[str, str], str] = {}
"""Reasons of differences that are meant, by patterns of case and field: ``("auto*", "interval"): "..."``."""

TINY = """\
name: tiny
steps: 20
simulator:
  {plugin: linear, states: [x], A: [[1]], process_noise: [0.0025], initial: {mean: [0], covariance: [0.0025]}}
specifications:
  near: {stl: "always (x < 0.55)"}
chunk: 50
"""
TINY_WITH_TWIN = f"{TINY}cheap: {{simulator: {{process_noise: [0.003]}}, cost: 0.1}}\n"
CASES = """\
tiny:
  mc: {plugin: mc, rollouts: 4000}
  mc runs: {plugin: mc, rollouts: 800, runs: 3}
  mc early_stop: {plugin: mc, rollouts: 2000, early_stop: true}
  mc relative_error: {plugin: mc, relative_error: 0.15}
  mc threshold: {plugin: mc, threshold: 0.02}
  ams: {plugin: ams, particles: 100, discard: 10, runs: 4}
  ams relative_error: {plugin: ams, relative_error: 0.2, runs: 5}
  ams early_stop: {plugin: ams, particles: 100, discard: 10, runs: 4, early_stop: true}
  ams published: {plugin: ams, particles: 100, discard: 10, runs: 4, variant: published}
  ess pcn: {plugin: ess, chains: 20, runs: 4}
  ess grow: {plugin: ess, runs: 4}
  ess first pass: {plugin: ess, chains: 20, runs: 4, second_pass: false}
  ess shrink: {plugin: ess, chains: 20, runs: 4, kernel: shrink}
  ess shrink bracket: {plugin: ess, chains: 20, runs: 4, kernel: {name: shrink, bracket: 3.0}}
  ess lipschitz: {plugin: ess, chains: 10, runs: 2, kernel: {name: lipschitz, bound: 1.0}}
  ess lipschitz_growing: {plugin: ess, chains: 20, runs: 4, kernel: lipschitz_growing}
  ess bayesian ucb: {plugin: ess, chains: 10, runs: 2, kernel: bayesian}
  ess bayesian ei:
    {plugin: ess, chains: 10, runs: 2, kernel: {name: bayesian, acquisition: {name: ei, xi: 0.1}}}
  ess bayesian poi: {plugin: ess, chains: 10, runs: 2, kernel: {name: bayesian, acquisition: poi}}
  ess_linear: {plugin: ess_linear, chains: 20, runs: 4}
  is learned: {plugin: is, rollouts: 6000, pilot: 500, stages: 3}
  is relative_error: {plugin: is, relative_error: 0.1}
  is gaussian: {plugin: is, rollouts: 2000, proposal: {name: gaussian, mean: 0.4}}
  smc learned: {plugin: smc, particles: 200, pilot: 500, stages: 2, runs: 4}
  smc: {plugin: smc, particles: 200, pilot: 500, stages: 2, runs: 4, proposal: none}
  auto: {plugin: auto}
  auto threshold: {plugin: auto, threshold: 0.02}
  cross-check: {plugin: ams, particles: 100, discard: 10, runs: 4}
tiny_with_twin:
  mfmc: {plugin: mfmc, rollouts: 4000}
scenarios/lane_change.yaml:
  lane change mc: {plugin: mc, rollouts: 200, chunk: 40}
  lane change ams:
    {plugin: ams, particles: 50, discard: 5, runs: 2, specifications: [no_collision], chunk: 25}
scenarios/lane_change_rare.yaml:
  lane change is, shipped proposal: {rollouts: 2000}
scenarios/lane_change_published.yaml:
  published mc: {plugin: mc, rollouts: 100, chunk: 25}
  published is naive:
    {plugin: is, rollouts: 60, proposal: {plugin: naive}, specifications: [safe_distance], chunk: 15}
  published ce network:
    {plugin: ce, rollouts: 50, stages: 2, specifications: [safe_distance], chunk: 25}
scenarios/double_integrator.yaml:
  double_integrator: {}
scenarios/constrained_gaussian.yaml:
  constrained_gaussian: {}
  constrained_gaussian ess_linear: {plugin: ess_linear, chains: 50, runs: 4}
scenarios/glider.yaml:
  glider: {}
  glider mc: {plugin: mc, rollouts: 4000}
scenarios/merge_lidar.yaml:
  merge_lidar mc: {plugin: mc, rollouts: 24, chunk: 6}
  merge_lidar ams: {plugin: ams, particles: 12, discard: 2, runs: 1, chunk: 6}
"""
"""Estimator blocks by scenario and case; one without a plugin changes options of the scenario's own.

``chunk`` is that of the scenario, small enough for a kill between two chunks.
"""
FORMER_SPELLINGS = """\
ess shrink bracket: {plugin: ess, chains: 20, runs: 4, kernel: shrink, bracket: 3.0}
ess lipschitz: {plugin: ess, chains: 10, runs: 2, kernel: lipschitz, lipschitz: 1.0}
ess bayesian ei: {plugin: ess, chains: 10, runs: 2, kernel: bayesian, acquisition: ei, xi: 0.1}
ess bayesian poi: {plugin: ess, chains: 10, runs: 2, kernel: bayesian, acquisition: poi}
is gaussian: {plugin: is, rollouts: 2000, proposal: {gaussian: {mean: 0.4}}}
"""
"""Blocks of cases in checkouts that have ``OPTIONS_IN_ONE_MODULE``."""
OPTIONS_IN_ONE_MODULE = "plugins/avrare-estimators/src/avrare_estimators/config.py"


@dataclass(frozen=True)
class Case:
    """A scenario with settings that replace its own."""

    name: str
    scenario: str
    settings: tuple[str, ...]

    @property
    def words(self) -> list[str]:
        """Words of the command line."""
        words = [self.scenario, *(word for setting in self.settings for word in ("--set", setting))]
        return [*words, "--cross-check"] if self.name == "cross-check" else words

    @property
    def key(self) -> str:
        """Key of its stored numbers."""
        return f"{self.name}: {Path(self.scenario).name} {' '.join(self.settings)}"


def list_cases(folder: Path, checkout: Path) -> list[Case]:
    """Return all cases as a checkout spells them; the tiny problems are written to ``folder``."""
    paths = {"tiny": folder / "tiny.yaml", "tiny_with_twin": folder / "tiny_with_twin.yaml"}
    paths["tiny"].write_text(TINY)
    paths["tiny_with_twin"].write_text(TINY_WITH_TWIN)
    former = yaml.safe_load(FORMER_SPELLINGS) if (checkout / OPTIONS_IN_ONE_MODULE).exists() else {}
    return [
        Case(name, str(paths.get(scenario, scenario)), tuple(_list_settings(former.get(name, block))))
        for scenario, cases in yaml.safe_load(CASES).items()
        for name, block in cases.items()
    ]


def _list_settings(block: dict[str, object]) -> Iterator[str]:
    if "chunk" in block:
        yield f"chunk={block.pop('chunk')}"
    if "plugin" in block:
        yield "estimator=" + yaml.safe_dump(block, default_flow_style=True, width=10**6).strip()
    else:
        yield from (f"estimator.{option}={value}" for option, value in block.items())


def measure(checkout: Path, case: Case, way: str) -> tuple[dict[str, object], int]:
    """Run a case; return its numbers by specification, and how many files were saved when it was killed."""
    with tempfile.TemporaryDirectory() as name:
        out = Path(name) / "run"
        command = [sys.executable, "-m", "avrare", "run", *case.words, "--no-pictures"]
        command += ["--workers", "2" if way == "two workers" else "1"]
        saved_files = 0
        if way == "resumed":
            saved_files = _kill_when_files_are_saved([*command, "--out", str(out)], checkout, out)
            if not saved_files:
                return {"failed": {"message": "the run ended before it could be killed"}}, 0
        command += ["--out", str(out), *(["--resume"] if saved_files else [])]
        process = subprocess.run(
            command, cwd=checkout, env=_environment(checkout), text=True, capture_output=True, check=False
        )
        if process.returncode:
            failure = {"exit code": process.returncode, "message": process.stderr.strip()[-500:]}
            return {"failed": failure}, saved_files
        return _read_numbers(out), saved_files


def _kill_when_files_are_saved(command: list[str], checkout: Path, out: Path) -> int:
    """Return the number of saved files; 0 where the run ended before."""
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    with subprocess.Popen(command, cwd=checkout, env=_environment(checkout), **quiet) as process:
        while process.poll() is None:
            saved_files = sum(len(files) for _, _, files in os.walk(out / "checkpoint"))
            if saved_files >= SAVED_FILES_BEFORE_KILL:
                process.kill()
                process.wait()
                return saved_files if (out / "checkpoint").exists() else 0
            time.sleep(0.002)
    return 0


def _environment(checkout: Path) -> dict[str, str]:
    folders = [checkout, *sorted(checkout.glob("plugins/*/src"))]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, folders)), "OMP_NUM_THREADS": "1"}


def _read_numbers(out: Path) -> dict[str, object]:
    content = json.loads((out / "result.json").read_text())
    tapes = np.load(out / "failures.npz") if (out / "failures.npz").exists() else {}
    numbers: dict[str, object] = {}
    for entry in content["estimates"]:
        name = entry["specification"]
        noise = tapes[f"{name}.noise"] if f"{name}.noise" in tapes else np.zeros(0)
        digest = hashlib.sha256(np.ascontiguousarray(noise).tobytes()).hexdigest()[:16]
        check = entry["cross_check"] or {}
        second = check.get("result", check) or {}  # older commits have its numbers in the check itself
        numbers[name] = {
            **{field: entry[field] for field in FIELDS},
            "failing tapes": digest,
            "cross_check": [check.get("estimator"), check.get("outcome"), second.get("probability")],
        }
    return numbers


def measure_all(checkout: Path, pattern: str, processes: int) -> dict[str, dict[str, object]]:
    """Return the numbers of all cases of a checkout, by case and way; stored ones are read."""
    commit = _git(checkout, "rev-parse", "--short=12", "HEAD")
    clean = not _git(checkout, "status", "--porcelain", "--untracked-files=no")
    path = STORED_RESULTS / f"{commit}.json"
    numbers = json.loads(path.read_text()) if clean and path.exists() else {}
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(processes) as pool:
        cases = [case for case in list_cases(Path(folder), checkout) if fnmatch(case.name, pattern)]
        new_cases = [case for case in cases if case.key not in numbers]
        print(f"{commit}: {len(new_cases)} cases to run, {len(cases) - len(new_cases)} stored", flush=True)
        jobs = {
            case.key: {way: pool.submit(measure, checkout, case, way) for way in WAYS} for case in new_cases
        }
        for key, ways in jobs.items():
            numbers[key] = {way: job.result()[0] for way, job in ways.items()}
            print(f"  {key}: resumed from {ways['resumed'].result()[1]} files", flush=True)
            if clean:
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_text(json.dumps(numbers, indent=1))
    return {case.name: numbers[case.key] for case in cases}


def list_differences(before: object, after: object, place: str = "") -> Iterator[str]:
    """Yield "field: old -> new" for each number that differs."""
    if isinstance(before, dict) and isinstance(after, dict):
        for key in {**before, **after}:
            yield from list_differences(before.get(key), after.get(key), f"{place}{key}: ")
    elif before != after:
        yield f"{place}{json.dumps(before)} -> {json.dumps(after)}"


def _accepted_reason(case: str, difference: str) -> str | None:
    for (name, field), reason in ACCEPTED.items():
        if fnmatch(case, name) and field in difference.split(": ")[:-1]:
            return reason
    return None


def report_case(name: str, after: dict[str, object], before: dict[str, object] | None) -> bool:
    """Print what differs in a case, between its ways and from ``before``; return True if all is well."""
    first = after[WAYS[0]]
    groups = [(way, list(list_differences(first, after[way]))) for way in WAYS[1:]]
    if before is not None:
        groups.append(("against", list(list_differences(before[WAYS[0]], first))))
    if isinstance(first, dict) and "failed" in first:
        groups.append(("", [json.dumps(first)]))
    well = True
    for label, differences in groups:
        for difference in differences:
            reason = _accepted_reason(name, difference) if label == "against" else None
            well = well and reason is not None
            print(f"{name}  {label}  {difference}" + (f"  (accepted: {reason})" if reason else ""))
    if not any(differences for _, differences in groups):
        print(f"{name}  equal")
    return well


def _git(folder: Path, *words: str) -> str:
    return subprocess.run(
        ["git", "-C", str(folder), *words], check=True, text=True, capture_output=True
    ).stdout.strip()


@contextlib.contextmanager
def check_out(revision: str) -> Iterator[Path]:
    """Give a temporary worktree of a revision."""
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder) / "checkout"
        _git(ROOT, "worktree", "add", "--detach", str(place), revision)
        try:
            yield place
        finally:
            _git(ROOT, "worktree", "remove", "--force", str(place))


def main() -> int:
    """Measure, compare and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--against", metavar="REVISION", help="commit to compare with")
    parser.add_argument("--only", default="*", metavar="PATTERN", help="cases whose name matches")
    parser.add_argument("--processes", type=int, default=2, help="runs at the same time")
    args = parser.parse_args()
    before: dict[str, dict[str, object]] = {}
    if args.against:
        with check_out(args.against) as place:
            before = measure_all(place, args.only, args.processes)
    after = measure_all(ROOT, args.only, args.processes)
    outcomes = [report_case(name, numbers, before.get(name)) for name, numbers in after.items()]
    print(f"{sum(outcomes)} of {len(outcomes)} cases are as they must be")
    return 0 if all(outcomes) else 1


if __name__ == "__main__":
    sys.exit(main())
