"""The table of a case study whose estimates lie in a folder, one JSON file an estimator."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any


def show(folder: Path, options: Mapping[str, Mapping[str, Any]]) -> None:
    """Print a row for each estimator that has been run.

    Args:
        folder: Holds NAME.json, as ``Result.to_json`` writes it.
        options: Of each estimator, by name.
    """
    print("| estimator | options | probability | 95 % interval | rollouts | steps | health |")
    print("|---|---|---|---|---|---|---|")
    for name, chosen in options.items():
        if not (folder / f"{name}.json").exists():
            continue
        found = json.loads((folder / f"{name}.json").read_text())
        low, high = found["interval"]
        print(
            f"| `{name}` | {', '.join(f'{key} {value}' for key, value in chosen.items())} "
            f"| {found['probability']:.2e} | {low:.1e} to {high:.1e} | {found['rollouts']:,} "
            f"| {found['simulated_steps']:,} | {', '.join(found['health']) or '-'} |"
        )
