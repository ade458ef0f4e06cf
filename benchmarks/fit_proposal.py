"""Proposal for a rare rule, learned from the failures of a more frequent one in a Monte Carlo sample.

    OMP_NUM_THREADS=1 python -m benchmarks.fit_proposal SCENARIO RULE OUT.json --frequent FORMULA
        [--rollouts 50000] [--seed 0] [--keep 200]

A score may not lead from the usual near misses to the rare failures; failures of the same rule at a milder
bound do. Of what is learned the largest components of one group of atoms are kept: pairs are large, and rest
on few failures. Estimate with another seed than this one.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from avrare.rollout.loaded_scenario import LoadedScenario
from avrare.rollout.noise import NoiseSource
from avrare.rollout.problem import Problem
from avrare.rollout.request import Request
from avrare.scenario.load import load
from avrare_estimators.common.learning.dictionary import fit
from avrare_estimators.common.tapes.tape_mixture import TapeMixture

DEFENSIVE = 0.25
"""Share of the rows that is drawn from the target."""


def prune(mixture: TapeMixture, keep: int) -> TapeMixture:
    """Return the mixture of the components with the largest shares, in their order."""
    components = mixture.components
    largest = np.sort(np.argsort([-share for share, _ in components], kind="stable")[:keep])
    total = sum(components[k][0] for k in largest)
    return TapeMixture.freeze([(components[k][0] / total, components[k][1]) for k in largest], mixture.shape)


def find_failures(problem: Problem, seed: int, rollouts: int) -> list[int]:
    """Return which of the first rollouts of a seed fail."""
    noise, failing = NoiseSource(seed, problem.noise_size), []
    for first in range(0, rollouts, problem.chunk):
        rows = np.arange(first, min(first + problem.chunk, rollouts))
        outcome = problem.simulate(noise, Request.from_start(np.zeros_like(rows), rows), scored=False)
        failing += rows[outcome.violated[:, 0]].tolist()
    return failing


def write_proposal(problem: Problem, rule: str, seed: int, failing: list[int], keep: int, out: Path) -> None:
    """Learn from the tapes of failing rollouts, and write the largest components."""
    particle = np.array(failing)[:, None]
    zeros = np.zeros_like(particle)
    noise = NoiseSource(seed, problem.noise_size)
    tapes = noise.normals(zeros, zeros, particle, np.arange(problem.steps + 1))
    learned = fit(tapes, np.ones(len(tapes)), DEFENSIVE)
    single = [(share, groups) for share, groups in learned.components if len(groups) == 1]
    total = sum(share for share, _ in single)
    components = [(share / total, groups) for share, groups in single]
    mixture = prune(TapeMixture.freeze(components, learned.shape), keep)
    content = {rule: {**mixture.to_dict(), "digest": mixture.digest}}
    out.write_text(json.dumps(content, separators=(",", ":")) + "\n", encoding="utf-8")


def main() -> None:
    """Drive, learn and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("scenario")
    parser.add_argument("rule")
    parser.add_argument("out", type=Path)
    parser.add_argument("--frequent", required=True, metavar="FORMULA")
    parser.add_argument("--rollouts", type=int, default=50_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--keep", type=int, default=200, help="components")
    args = parser.parse_args()
    specification = json.dumps({"stl": args.frequent})
    settings = [f"specifications.{args.rule}={specification}", "estimator={plugin: mc}"]
    problem = LoadedScenario(load(args.scenario, settings)).problem(args.rule)
    failing = find_failures(problem, args.seed, args.rollouts)
    print(f"{len(failing)} failures of {args.rollouts} rollouts")
    write_proposal(problem, args.rule, args.seed, failing, args.keep, args.out)


if __name__ == "__main__":
    main()
