"""What ``avrare pem fit`` writes: model, card, scores and a picture. Needs the ``train`` extra."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

from avrare.errors import UsageError
from avrare_gp_pem.card import TITLES, card
from avrare_gp_pem.clean import Cleaned
from avrare_gp_pem.evaluate import evaluate, yaw_scores
from avrare_gp_pem.picture import draw
from avrare_gp_pem.scores import NAMES
from avrare_gp_pem.store import FittedPem, save

if TYPE_CHECKING:
    from avrare_gp_pem.fitting import Plan

Scores = Mapping[str, Mapping[str, float]]


def provenance(plan: Plan, data: Cleaned, given: Mapping[str, str]) -> dict[str, str]:
    """What is kept with a model: what was fitted to what, and under which licence."""
    rows = f"{len(data.train)} training ({int(data.oblique.sum())} of them clean), {len(data.test)} held out"
    libraries = ["torch", "numpy", "scipy", *(["pyro-ppl"] if plan.model == "gp" else [])]
    return {
        **given,
        "model": plan.model,
        "rows": rows,
        "artefact of matching": "modelled apart" if data.has_artefact else "none",
        "seed": str(plan.seed),
        "fitted with": ", ".join(f"{name} {version(name)}" for name in ("avrare-gp-pem", *libraries)),
    }


def write_report(folder: Path, name: str, model: FittedPem, data: Cleaned) -> list[str]:
    """Write NAME.npz, NAME.md, NAME.json and NAME.png; returns lines for the terminal.

    Raises:
        UsageError: A file cannot be written.
    """
    scored, yaw = evaluate(model, data), yaw_scores(model, data)
    scores = {part: one.scores for part, one in scored.items()}
    paths = [folder / f"{name}.{ending}" for ending in ("npz", "md", "json", "png")]
    try:
        save(paths[0], model)
        paths[1].write_text(card(name, model, data, scores, yaw), encoding="utf-8")
        paths[2].write_text(as_json(scores | {"yaw": yaw}) + "\n", encoding="utf-8")
        draw(paths[3], f"{name}: {model.provenance.get('model', '')} on held-out rows", scored)
    except OSError as error:
        raise UsageError(f"{error.filename or folder}: cannot be written: {error.strerror}") from None
    return [*summary(scores), *(f"wrote {path}" for path in paths)]


def as_json(scores: Scores) -> str:
    """Scores as a JSON object; what is no finite number is null."""
    finite = {
        part: {name: value if math.isfinite(value) else None for name, value in s.items()}
        for part, s in scores.items()
    }
    return json.dumps(finite, indent=2)


def summary(scores: Scores) -> Iterator[str]:
    """The scores that matter, as lines."""
    for part, s in scores.items():
        yield (
            f"{TITLES[part]}: detection NLL {s['detection_nll']:.4f} (base {s['detection_base_nll']:.4f}), "
            f"AUC {s['detection_auc']:.3f}, ECE {s['detection_calibration_error']:.4f}"
        )
        for name in (name for names in NAMES.values() for name in names if f"{name}_nll" in s):
            yield (
                f"  error {name}: NLL {s[f'{name}_nll']:.4f}, P(|z| > 4) {100 * s[f'{name}_z4']:.2f} %, "
                f"the model's own {100 * s[f'{name}_z4_own']:.2f} %"
            )
