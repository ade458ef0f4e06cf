"""``avrare pem fit``: from clean rows to a fitted and calibrated model. Needs the ``train`` extra."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.stats import t as student_t

from avrare.errors import UsageError
from avrare_gp_pem.calibrate import Unseen, calibrate
from avrare_gp_pem.clean import Cleaned
from avrare_gp_pem.features import AXES, COMMON, features
from avrare_gp_pem.fit import Schedule, fit_base_scale
from avrare_gp_pem.fit_networks import Recipe, Sample, fit_networks
from avrare_gp_pem.store import FittedPem
from avrare_gp_pem.table import Table, errors_in
from avrare_gp_pem.variant import Latents, Variant
from avrare_gp_pem.yaw import YawLaw, split

Floats = NDArray[np.float64]
Report = Callable[[str], None]
_FEW = ("range", "reach", "cos_2aspect", "length", "width", "height", "visibility")
RECIPES: Mapping[str, tuple[Recipe, tuple[str, ...]]] = {
    "mlp": (Recipe(), COMMON),
    "student": (Recipe(hidden=(), rate=1e-2, dropout=0.0), COMMON),
    "logistic": (Recipe(hidden=(), varying=False, rate=1e-2, dropout=0.0), _FEW),
}
"""What ``--model`` may name beside ``gp``, and the columns that it reads."""
_LEAST_LIMIT, _MARGIN = 8.0, 1.5
"""An error may be at least so large [m], and so many times the largest of the training rows."""
_UNSURE = 1e-6  # a column that varies less than this is no input


@dataclass(frozen=True)
class Plan:
    """What to fit.

    Attributes:
        model: "gp" or a name in ``RECIPES``.
        seed: Of everything random.
        recipe: Instead of the model's own, for networks.
        schedule: Instead of the usual one, for Gaussian processes.
    """

    model: str
    seed: int = 0
    recipe: Recipe | None = None
    schedule: Schedule | None = None


def fit_model(data: Cleaned, plan: Plan, provenance: Mapping[str, str], report: Report) -> FittedPem:
    """Fit the detector, and where the labels have an artefact, the labels as delivered too.

    Args:
        data: Clean rows; the held-out ones are not looked at.
        plan: What to fit; the same plan gives the same bits on the same machine.
        provenance: Kept with the model.
        report: Called with lines of progress.
    """
    oblique = data.train.take(data.oblique)
    clean = _fit(oblique, plan, "vehicle", lambda line: report(f"detector: {line}"))
    delivered = None
    if data.has_artefact:
        delivered = _fit(data.train, plan, "ego", lambda line: report(f"labels: {line}"))
    return FittedPem(clean, delivered, dict(provenance), fit_yaw(oblique))


def _fit(rows: Table, plan: Plan, frame: str, report: Report) -> Variant:
    """One law, with errors in ``frame``; only the labels' own frame reads how boxes lie to the ego's axes."""
    wanted = COMMON if plan.model == "gp" else RECIPES[plan.model][1]
    columns = features(rows.box, (*wanted, *(AXES if frame == "ego" else ())))
    varying = columns.std(axis=0) > _UNSURE
    names = tuple(np.array((*wanted, *(AXES if frame == "ego" else ())))[varying].tolist())
    columns = columns[:, varying]
    mean, sd = columns.mean(axis=0), columns.std(axis=0)
    errors, distance = errors_in(frame, rows), rows.box.range
    base = fit_base_scale(distance[rows.detected], errors[rows.detected])
    standard = np.nan_to_num(errors / (base[:, 0] + base[:, 1] * distance[:, None]))
    sample = Sample((columns - mean) / sd, rows.detected, standard)
    latents, unseen = _latents(sample, plan, distance, errors, report)
    variant = Variant(
        latents=latents,
        inputs=names,
        input_mean=mean,
        input_sd=sd,
        base_scale=base,
        dof=np.full(2, 3.0),
        limit=np.array(max(_LEAST_LIMIT, math.ceil(_MARGIN * float(np.nanmax(np.abs(errors)))))),
        link="probit" if plan.model == "gp" else "logit",
        frame=frame,
        bounds=np.stack([columns.min(axis=0), columns.max(axis=0)]),
    )
    variant = calibrate(variant, unseen)
    report(
        f"calibrated: slope {variant.line[0]:.3f}, offset {variant.line[1]:.3f}, "
        f"scales x {variant.stretch[0]:.2f} and {variant.stretch[1]:.2f}, "
        f"{variant.dof[0]:.2f} and {variant.dof[1]:.2f} degrees of freedom"
    )
    return variant


def _latents(
    sample: Sample, plan: Plan, distance: Floats, errors: Floats, report: Report
) -> tuple[Latents, Unseen]:
    if plan.model == "gp":
        from avrare_gp_pem.fit_gp import SCHEDULE, fit_gps

        schedule = replace(plan.schedule or SCHEDULE, seed=plan.seed)
        pair, mean, variance, rows = fit_gps(sample, schedule, report)
        return pair, Unseen(mean, variance, distance[rows], sample.detected[rows], errors[rows])
    recipe = plan.recipe or RECIPES[plan.model][0]
    fitted, left_out = fit_networks(sample, recipe, plan.seed, report)
    return fitted, Unseen(left_out, np.zeros_like(left_out), distance, sample.detected, errors)


def fit_yaw(rows: Table) -> YawLaw | None:
    """The law of errors of yaw; None where the rows have none."""
    known = rows.detected & np.isfinite(rows.error_yaw)
    if known.sum() < 100:
        return None
    distance = rows.box.range[known]
    flipped, rest = split(rows.error_yaw[known])

    def loss(parameters: Floats) -> float:
        argument = parameters[0] + parameters[1] * distance / 50
        return float(
            np.logaddexp(0.0, np.where(flipped, -argument, argument)).mean() + 1e-4 * (parameters**2).sum()
        )

    flip = minimize(loss, [-3.0, 1.0], method="Nelder-Mead").x / np.array([1.0, 50.0])
    spread = max(float(np.median(np.abs(rest))), 1e-3)

    def rest_loss(parameters: Floats) -> float:
        base, slope, freedom = np.exp(np.clip(parameters, -20.0, 5.0))
        dof = min(1.05 + freedom, 30.0)
        return -float(student_t.logpdf(rest, dof, scale=base + slope * distance).mean())

    found = minimize(rest_loss, np.log([spread / 2, spread / 60, 1.5]), method="Nelder-Mead").x
    base, slope, freedom = np.exp(np.clip(found, -20.0, 5.0))
    return YawLaw(flip, np.array([base, slope]), np.array(min(1.05 + freedom, 30.0)))


def check_model(name: str) -> None:
    """Raise ``UsageError`` unless ``name`` can be fitted."""
    if name != "gp" and name not in RECIPES:
        raise UsageError(f"unknown model {name!r}", f"known: gp, {', '.join(RECIPES)}")
