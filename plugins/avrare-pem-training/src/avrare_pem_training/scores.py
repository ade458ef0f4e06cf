"""Scores of a fitted model on held-out rows: detection, errors, and the tails of errors.

A standardised error is z = (error - location) / scale. A Student-t distribution has P(|z| > 4) of
a few per cent: the scores compare this share with the observed one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import rankdata

from avrare.protocols import Bools, Floats
from avrare_gp_pem.runtime.observation_model import ObservationLaw
from avrare_gp_pem.runtime.student_t import student
from avrare_gp_pem.runtime.variant import FittedPem, Variant, separate_flips
from avrare_pem_training.cleaning import CleanedData
from avrare_pem_training.table import DetectionTable, errors_in

AXIS_NAMES = {"vehicle": ("along", "across"), "ego": ("right", "forward")}
"""Names of the two errors, by frame."""
TAILS = (2.0, 4.0, 8.0)
"""Sizes of z whose shares are compared."""


@dataclass(frozen=True)
class ErrorFit:
    """One error of all detections, against its distribution.

    Attributes:
        z: (m,) standardised errors.
        log_density: (m,) of the errors [log 1/m].
        bound: (m,) end of the distribution, in units of its scale.
        dof: Degrees of freedom of the distribution.
        power: (m,) powers of its tails.
    """

    z: Floats
    log_density: Floats
    bound: Floats
    dof: float
    power: Floats

    def beyond(self, size: float) -> tuple[float, float]:
        """Return the share of |z| > ``size``: observed, and according to the model."""
        modelled = np.where(self.bound > size, self._tail(np.asarray(size)), 0.0)
        return float((np.abs(self.z) > size).mean()), float(modelled.mean())

    def beyond_sd(self, count: float) -> tuple[float, float]:
        """Return the share of |z| above ``count`` standard deviations of the model: observed and modelled."""
        size = count * _truncated_sd(self.dof, self.bound, self.power)
        return float((np.abs(self.z) > size).mean()), float(self._tail(size).mean())

    def _tail(self, size: Floats) -> Floats:
        table, cut = student(self.dof), np.minimum(self.bound, size)
        tail, end = (table.upper_tail(x, self.power) for x in (cut, self.bound))
        return 2 * (tail - end) / (1 - 2 * end)


@dataclass(frozen=True)
class ScoredRows:
    """Predictions for held-out rows.

    Attributes:
        title: Model and rows, for a picture.
        law: Predictions, fields (n,).
        rows: The rows.
        errors: (n, 2) in the frame of the predictions [m].
        frame: "vehicle" or "ego".
        scores: See ``score``.
    """

    title: str
    law: ObservationLaw
    rows: DetectionTable
    errors: Floats
    frame: str
    scores: dict[str, float]


def evaluate(model: FittedPem, data: CleanedData) -> dict[str, ScoredRows]:
    """Score the model on the held-out rows.

    Returns:
        ``delivered``: the labels' distribution on the rows as delivered (the detector's, where labels have no
        artefact); ``clean``: the detector's on rows free of the artefact; ``clean_on_delivered``: the
        detector's on all rows, which shows the effect of the artefact.
    """
    all_rows = (data.test, data.train)
    clean_rows = (data.test.take(data.test_oblique), data.train.take(data.oblique))
    labels = model.delivered or model.clean
    parts = {
        "delivered": _score_rows("labels as delivered", labels, *all_rows),
        "clean": _score_rows("detector, clean rows", model.clean, *clean_rows),
    }
    if model.delivered is not None:
        parts["clean_on_delivered"] = _score_rows("detector, rows as delivered", model.clean, *all_rows)
    return parts


def score(
    law: ObservationLaw, detected: Bools, errors: Floats, base_rate: float, frame: str
) -> dict[str, float]:
    """Return all scores of predictions (fields (n,)).

    Args:
        law: Predictions.
        detected: (n,) outcomes.
        errors: (n, 2) in the frame of the predictions [m]; NaN where missed.
        base_rate: Detection rate of the training rows, the baseline.
        frame: "vehicle" or "ego": names the errors.

    Returns:
        ``detection_*`` (see ``detection_scores``), and for each error:
        ``nll``: negative log likelihood [nats, errors in metres];
        ``dof``: degrees of freedom;
        ``z4``: observed share beyond 4 scales, and ``z4_own`` that of the model;
        ``4sd``: observed share beyond 4 standard deviations, and ``4sd_own`` that of the model.
    """
    scores = detection_scores(law.detect, detected, base_rate)
    scores["error_rows"] = float(detected.sum())
    for name, fit in zip(AXIS_NAMES[frame], fit_errors(law, detected, errors), strict=True):
        scores[f"{name}_nll"] = -float(fit.log_density.mean())
        scores[f"{name}_dof"] = fit.dof
        for size in TAILS:
            scores[f"{name}_z{size:g}"], scores[f"{name}_z{size:g}_own"] = fit.beyond(size)
        scores[f"{name}_4sd"], scores[f"{name}_4sd_own"] = fit.beyond_sd(4.0)
    return scores


def detection_scores(detect: Floats, detected: Bools, base_rate: float) -> dict[str, float]:
    """Return scores of predicted detection probabilities (n,).

    Args:
        detect: Predictions.
        detected: (n,) outcomes.
        base_rate: Detection rate of the training rows, the baseline.

    Returns:
        Negative log likelihoods per row [nats], area under the ROC curve (NaN where all or none are
        detected), Brier score, and expected calibration error over ten bins of equal count.
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


def fit_errors(law: ObservationLaw, detected: Bools, errors: Floats) -> list[ErrorFit]:
    """Compare both errors (n, 2) of the detected rows with their distribution (fields (n,))."""
    fits = []
    for axis, dof in enumerate(law.dof):
        scale = law.scale[detected, axis]
        z = (errors[detected, axis] - law.location[detected, axis]) / scale
        bound = law.limit / scale
        power = np.ones_like(z) if law.power is None else law.power[detected, axis]
        density = student(dof).truncated_log_density(z, bound, power) - np.log(scale)
        fits.append(ErrorFit(z, density, bound, dof, power))
    return fits


def yaw_scores(model: FittedPem, data: CleanedData) -> dict[str, float]:
    """Return scores of the yaw errors of held-out clean detections; empty where the model has none."""
    rows = data.test.take(data.test_oblique)
    measured = rows.detected & np.isfinite(rows.error_yaw)
    if model.yaw is None or not measured.any():
        return {}
    distance, error = rows.range[measured], rows.error_yaw[measured]
    flipped, rest = separate_flips(error)
    return {
        "yaw_rows": float(measured.sum()),
        "yaw_flips": float(flipped.mean()),
        "yaw_flips_own": float(model.yaw.flip_probability(distance).mean()),
        "yaw_nll": -float(model.yaw.log_density(error, distance).mean()),
        "yaw_rest_median": float(np.median(np.abs(rest))),
    }


def _score_rows(title: str, variant: Variant, rows: DetectionTable, train: DetectionTable) -> ScoredRows:
    law = variant.law(rows, speed_sd=0.0)
    errors = errors_in(variant.frame, rows)
    scores = score(law, rows.detected, errors, float(train.detected.mean()), variant.frame)
    return ScoredRows(title, law, rows, errors, variant.frame, scores)


def _truncated_sd(dof: float, bound: Floats, power: Floats) -> Floats:
    """Return (m,) standard deviations; between powers of a grid they are interpolated."""
    grid = np.unique(np.linspace(power.min(), power.max(), 9))
    at_grid = np.stack([_sd_at_power(dof, bound, exponent) for exponent in grid])
    place = np.clip(np.searchsorted(grid, power) - 1, 0, max(len(grid) - 2, 0))
    above, rows = np.minimum(place + 1, len(grid) - 1), np.arange(len(power))
    share = (power - grid[place]) / np.where(above > place, grid[above] - grid[place], 1.0)
    return np.asarray(at_grid[place, rows] * (1 - share) + at_grid[above, rows] * share)


def _sd_at_power(dof: float, bound: Floats, power: float) -> Floats:
    ends = np.minimum(np.arcsinh(power * bound) / power, 8.0)  # where the error has no bound
    x = np.linspace(0.0, float(ends.max()), 4001)
    t = np.sinh(x)
    density = np.exp(student(dof).log_density(t)) * np.cosh(x)
    square = (np.sinh(power * x) / power) ** 2
    steps = np.diff(x) / 2
    mass, second = (np.append(0.0, np.cumsum((f[1:] + f[:-1]) * steps)) for f in (density, density * square))
    return np.asarray(np.sqrt(np.interp(ends, x, second) / np.interp(ends, x, mass)))
