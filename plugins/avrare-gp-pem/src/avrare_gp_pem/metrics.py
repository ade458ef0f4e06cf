"""How well a fitted model predicts rows that it has not seen. Needs the ``train`` extra."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri
from scipy.stats import rankdata

from avrare_gp_pem.data import Rows
from avrare_gp_pem.law import ErrorLaw
from avrare_gp_pem.student import student

Floats = NDArray[np.float64]


def detection_metrics(detect: Floats, detected: NDArray[np.bool_], base_rate: float) -> dict[str, float]:
    """Scores of predicted detection probabilities (n,).

    Args:
        detect: Predictions.
        detected: What happened.
        base_rate: Detection rate of the training rows, the baseline.

    Returns:
        Negative log likelihoods per row, area under the ROC curve (NaN where all or none are detected),
        Brier score, and expected calibration error over ten bins of equal count.
    """
    detect = np.clip(detect, 1e-12, 1 - 1e-12)
    positives = int(detected.sum())
    pairs = positives * (len(detected) - positives)
    ranks = rankdata(detect)[detected].sum() - positives * (positives + 1) / 2
    bins = np.array_split(np.argsort(detect, kind="stable"), 10)
    gaps = [len(b) * abs(float(detect[b].mean() - detected[b].mean())) for b in bins if len(b)]
    return {
        "detection_rows": float(len(detect)),
        "detection_base_nll": float(-np.log(np.where(detected, base_rate, 1 - base_rate)).mean()),
        "detection_nll": float(-np.log(np.where(detected, detect, 1 - detect)).mean()),
        "detection_auc": float(ranks / pairs) if pairs else float("nan"),
        "detection_brier": float(((detect - detected) ** 2).mean()),
        "detection_calibration_error": sum(gaps) / len(detect),
    }


def error_metrics(law: ErrorLaw, rows: Rows) -> dict[str, float]:
    """Scores of predicted errors: likelihoods, and how often the normal score of an error exceeds 2, 3, 4."""
    scores: dict[str, float] = {"error_rows": float(rows.detected.sum())}
    for axis, name in enumerate(("along", "across")):
        scale = law.scale[rows.detected, axis]
        standard = (rows.errors[rows.detected, axis] - law.location[rows.detected, axis]) / scale
        bound = law.limit / scale
        distribution = student(law.dof[axis])
        density = distribution.truncated_log_density(standard, bound) - np.log(scale)
        beyond = distribution.upper_tail(bound)
        tail = (distribution.upper_tail(np.abs(standard)) - beyond) / (1 - 2 * beyond)
        score = -ndtri(np.clip(tail, 1e-15, 0.5))
        scores[f"error_nll_{name}"] = float(-density.mean())
        scores |= {f"error_beyond_{k}_{name}": float((score > k).mean()) for k in (1, 2, 3, 4)}
    return scores
