"""A model on held-out rows, as delivered and clean. Needs the ``train`` extra."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from avrare_gp_pem.clean import Cleaned
from avrare_gp_pem.law import ErrorLaw
from avrare_gp_pem.scores import score
from avrare_gp_pem.store import FittedPem
from avrare_gp_pem.table import Table, errors_in
from avrare_gp_pem.variant import Variant
from avrare_gp_pem.yaw import split

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Scored:
    """A law on held-out rows.

    Attributes:
        title: Which law, on which rows.
        law: Predictions, fields (n,).
        rows: The rows.
        errors: (n, 2) in the law's frame [m].
        frame: "vehicle" or "ego".
        scores: See ``scores.score``.
    """

    title: str
    law: ErrorLaw
    rows: Table
    errors: Floats
    frame: str
    scores: dict[str, float]


def evaluate(model: FittedPem, data: Cleaned) -> dict[str, Scored]:
    """The model on the held-out rows.

    Returns:
        ``delivered``: the labels' law on the rows as delivered (the detector's, where labels have no
        artefact); ``clean``: the detector's on rows free of the artefact; ``clean_on_delivered``: the
        detector's on all, which shows what the artefact takes.
    """
    labels = model.delivered or model.clean
    parts = {
        "delivered": ("labels as delivered", labels, data.test, data.train),
        "clean": (
            "detector, clean rows",
            model.clean,
            data.test.take(data.test_oblique),
            data.train.take(data.oblique),
        ),
    }
    if model.delivered is not None:
        parts["clean_on_delivered"] = ("detector, rows as delivered", model.clean, data.test, data.train)
    return {
        name: _scored(title, variant, rows, float(train.detected.mean()))
        for name, (title, variant, rows, train) in parts.items()
    }


def yaw_scores(model: FittedPem, data: Cleaned) -> dict[str, float]:
    """How the law of yaw predicts held-out clean detections; empty without one."""
    rows = data.test.take(data.test_oblique)
    known = rows.detected & np.isfinite(rows.error_yaw)
    if model.yaw is None or not known.any():
        return {}
    distance, error = rows.box.range[known], rows.error_yaw[known]
    flipped, rest = split(error)
    return {
        "yaw_rows": float(known.sum()),
        "yaw_flips": float(flipped.mean()),
        "yaw_flips_own": float(model.yaw.flip_probability(distance).mean()),
        "yaw_nll": -float(model.yaw.log_density(error, distance).mean()),
        "yaw_rest_median": float(np.median(np.abs(rest))),
    }


def _scored(title: str, variant: Variant, rows: Table, base_rate: float) -> Scored:
    law = variant.law(rows.box, speed_sd=0.0)
    errors = errors_in(variant.frame, rows)
    scores = score(law, rows.detected, errors, base_rate, variant.frame)
    return Scored(title, law, rows, errors, variant.frame, scores)
