"""Learned proposal cut down to its largest components, small enough to be kept beside a scenario.

    python -m benchmarks.prune_proposal RUN/learned.json OUT.json [--keep 100] [--truth FILE.json RULE LEVEL]

Any proposal gives unbiased estimates; the small components of a fit rest on few failures each. With a truth
it prints the gain over Monte Carlo of both on the rollouts of the truth whose robustness is at most the
level: 1 over the mean of p/q, a quarter of the rows drawn from the target; and the largest p/q, at most 4,
which shows whether failures are left that only those rows draw.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np

from avrare.protocols import Floats
from avrare.rollout.noise import NoiseSource
from avrare_estimators.common.tapes.tape_mixture import TapeMixture
from avrare_estimators.importance.proposal_file import ProposalFile
from benchmarks.studies import truth

DEFENSIVE = 0.25


def prune(mixture: TapeMixture, keep: int) -> TapeMixture:
    """Return the mixture of the components with the largest shares, in their order."""
    components = mixture.components
    largest = np.sort(np.argsort([-share for share, _ in components], kind="stable")[:keep])
    total = sum(components[k][0] for k in largest)
    return TapeMixture.freeze([(components[k][0] / total, components[k][1]) for k in largest], mixture.shape)


def failing_tapes(file: Path, rule: str, level: float, shape: tuple[int, int]) -> Floats:
    """Return the noise (M, T + 1, D) of a truth's rollouts whose robustness is at most the level."""
    tail, seed = truth.read_tails(file)[rule], json.loads(file.read_text(encoding="utf-8"))["seed"]
    particle = tail.particle[tail.robustness <= level][:, None]
    zeros = np.zeros_like(particle)
    return NoiseSource(seed, shape[1]).normals(zeros, zeros, particle, np.arange(shape[0]))


def weights(mixture: TapeMixture, tapes: Floats) -> Floats:
    """Return p/q (M,) of failing tapes (M, T + 1, D)."""
    ratio = np.exp(mixture.log_ratio_of(tapes))
    return np.asarray(1.0 / (DEFENSIVE + (1.0 - DEFENSIVE) / ratio))


def gain(mixture: TapeMixture, tapes: Floats) -> float:
    """Return the gain over Monte Carlo on failing tapes (M, T + 1, D)."""
    return float(1.0 / weights(mixture, tapes).mean())


def main() -> None:
    """Read, prune and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("learned", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--keep", type=int, default=100, help="components")
    parser.add_argument("--truth", nargs=3, metavar=("FILE", "RULE", "LEVEL"), help="of docs/ground-truth")
    args = parser.parse_args()
    content: dict[str, Any] = {}
    for name, mixture in ProposalFile.read(args.learned).mixtures.items():
        pruned = prune(mixture, args.keep)
        if args.truth:
            file, rule, level = args.truth
            tapes = failing_tapes(Path(file), rule, float(level), mixture.shape)
            for one in (mixture, pruned):
                largest = weights(one, tapes).max()
                said = f"{len(tapes)} failures: gain {gain(one, tapes):.1f}, largest p/q {largest:.2f}"
                print(f"{len(one.components)} components, {said}")
        content[name] = {**pruned.to_dict(), "digest": pruned.digest}
    args.out.write_text(json.dumps(content, separators=(",", ":")) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
