"""Exact failure probabilities of the problems, kept in truths.json.

``python -m benchmarks.unseen.truths`` computes each twice, with quadratures of two orders (or grids of two
sizes), and keeps their relative difference, too. Sums and closed forms have none.
"""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

from .problems import CASES, exact

FILE = Path(__file__).parent / "truths.json"
HIGHER_ORDER = 10


@cache
def stored() -> dict[str, float]:
    """Return the kept probabilities by name."""
    return {
        name: entry["probability"] for name, entry in json.loads(FILE.read_text(encoding="utf-8")).items()
    }


def main() -> None:
    """Compute all probabilities and keep them."""
    probabilities = {name: case.exact() for name, case in CASES.items()}
    exact.ORDER = HIGHER_ORDER
    entries = {}
    for name, case in CASES.items():
        probability = case.exact()
        change = float(f"{abs(probabilities[name] / probability - 1):.1e}")
        entries[name] = {"probability": probability, "method": case.method, "relative_difference": change}
    FILE.write_text(json.dumps(entries, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
