"""Learned proposal cut down to its largest components, small enough to be kept beside a scenario.

    python benchmarks/prune_proposal.py RUN/learned.json OUT.json [--keep 100]

Any proposal gives unbiased estimates; the small components of a fit rest on few failures each.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np

from avrare_estimators.importance.proposal_file import ProposalFile
from avrare_estimators.importance.tape_mixture import TapeMixture


def prune(mixture: TapeMixture, keep: int) -> TapeMixture:
    """Return the mixture of the components with the largest shares, in their order."""
    components = mixture.components
    largest = np.sort(np.argsort([-share for share, _ in components], kind="stable")[:keep])
    total = sum(components[k][0] for k in largest)
    return TapeMixture.frozen([(components[k][0] / total, components[k][1]) for k in largest], mixture.shape)


def main() -> None:
    """Read, prune and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("learned", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--keep", type=int, default=100, help="components")
    args = parser.parse_args()
    content: dict[str, Any] = {}
    for name, mixture in ProposalFile.read(args.learned).mixtures.items():
        pruned = prune(mixture, args.keep)
        content[name] = {**pruned.to_dict(), "digest": pruned.digest}
    args.out.write_text(json.dumps(content, separators=(",", ":")) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
