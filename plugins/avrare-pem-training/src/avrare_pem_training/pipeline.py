"""Fitting pipeline of ``avrare pem fit``: from clean rows to a fitted and calibrated model."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import minimize
from scipy.stats import t as student_t

from avrare.protocols import Floats
from avrare_gp_pem.runtime.features import AXES, COMMON, LITERAL, features
from avrare_gp_pem.runtime.variant import FittedPem, Latents, Variant, YawErrors, separate_flips
from avrare_pem_training.calibration import MAX_DOF, MIN_DOF, UnseenRows, calibrate
from avrare_pem_training.cleaning import CleanedData
from avrare_pem_training.fit_networks import Recipe, Sample, fit_networks
from avrare_pem_training.ghost_log import describe_ghosts, fit_ghosts
from avrare_pem_training.persistence import describe_persistence, fit_persistence
from avrare_pem_training.table import DetectionTable, errors_in

if TYPE_CHECKING:
    from avrare_pem_training.fit_gp import Schedule

Report = Callable[[str], None]
_BASELINE_COLUMNS = ("range", "reach", "cos_2aspect", "length", "width", "height", "visibility")
RECIPES: Mapping[str, tuple[Recipe, tuple[str, ...]]] = {
    "mlp": (Recipe(), COMMON),
    "student": (Recipe(hidden=(), rate=1e-2, dropout=0.0), COMMON),
    "logistic": (Recipe(hidden=(), varying=False, rate=1e-2, dropout=0.0), _BASELINE_COLUMNS),
}
"""Recipe and columns of every ``--model`` but ``gp``."""
_MIN_LIMIT, _LIMIT_MARGIN = 8.0, 1.5  # [m], and in units of the largest error of the training rows
_MIN_SD = 1e-6  # a column that varies less is dropped
_MIN_SCALE = 1e-4  # errors may all be zero [m]


@dataclass(frozen=True)
class FitPlan:
    """Model to fit.

    Attributes:
        model: "gp", "literal" or a name in ``RECIPES``.
        seed: Seed of everything random.
        recipe: Replaces the model's recipe, for networks.
        schedule: Replaces the default schedule, for Gaussian processes.
    """

    model: str
    seed: int = 0
    recipe: Recipe | None = None
    schedule: Schedule | None = None


@dataclass(frozen=True)
class Fit:
    """Fitted model, with the plan that a refit to other rows needs.

    Attributes:
        model: The model.
        plan: Its plan, for networks with the schedule that was found for the detector.
    """

    model: FittedPem
    plan: FitPlan


def fit_model(
    data: CleanedData,
    plan: FitPlan,
    provenance: Mapping[str, str],
    report: Report,
    *,
    whole: bool = True,
) -> Fit:
    """Fit the detector, and where the labels have an artefact, the labels as delivered too.

    Args:
        data: Clean rows; the held-out ones are not read.
        plan: Model to fit; the same plan gives the same bits on the same machine.
        provenance: Stored with the model.
        report: Called with lines of progress.
        whole: False: fit the detector alone, neither the labels as delivered nor how long errors last.
    """
    oblique = data.train.take(data.oblique)
    fit = _fit_literal_variant if plan.model == "literal" else _fit_variant
    clean, recipe = fit(oblique, plan, "vehicle", lambda line: report(f"detector: {line}"))
    delivered = None
    if data.has_artefact and whole:
        delivered, _ = fit(data.train, plan, "ego", lambda line: report(f"labels: {line}"))
    lasting = None
    if whole:
        lasting = fit_persistence(clean, oblique)
        report(describe_persistence(lasting))
    ghosts = fit_ghosts(data.ghosts) if data.ghosts is not None else None
    report(describe_ghosts(ghosts, data.ghosts, data.test_ghosts))
    model = FittedPem(clean, delivered, dict(provenance), fit_yaw(oblique), lasting, ghosts)
    return Fit(model, replace(plan, recipe=recipe))


def _fit_variant(
    rows: DetectionTable, plan: FitPlan, frame: str, report: Report
) -> tuple[Variant, Recipe | None]:
    # 1. Inputs; only the labels' own frame reads the orientation of boxes relative to the ego's axes.
    inputs = COMMON if plan.model == "gp" else RECIPES[plan.model][1]
    inputs = (*inputs, *AXES) if frame == "ego" else inputs
    columns = features(rows, inputs)
    varying = columns.std(axis=0) > _MIN_SD
    columns = columns[:, varying]
    mean, sd = columns.mean(axis=0), columns.std(axis=0)
    # 2. Errors over a base scale that is linear in range.
    errors, distance = errors_in(frame, rows), rows.range
    base = fit_base_scale(distance[rows.detected], errors[rows.detected])
    standard = np.nan_to_num(errors / (base[:, 0] + base[:, 1] * distance[:, None]))
    # 3. Latent functions, then calibration on rows that they were not fitted to.
    sample = Sample((columns - mean) / sd, rows.detected, standard)
    latents, unseen, recipe = _fit_latents(sample, plan, distance, errors, report)
    variant = Variant(
        latents=latents,
        inputs=tuple(np.array(inputs)[varying].tolist()),
        input_mean=mean,
        input_sd=sd,
        base_scale=base,
        dof=np.full(2, 3.0),
        limit=np.array(max(_MIN_LIMIT, math.ceil(_LIMIT_MARGIN * float(np.nanmax(np.abs(errors)))))),
        link="probit" if plan.model == "gp" else "logit",
        frame=frame,
        bounds=np.stack([columns.min(axis=0), columns.max(axis=0)]),
    )
    variant = calibrate(variant, unseen)
    powers = ", ".join(f"{far:.2f} ({far * near:.2f} at range 0)" for far, near in np.exp(variant.tail))
    report(
        f"calibrated: slope {variant.line[0]:.3f}, offset {variant.line[1]:.3f} "
        f"({variant.line[1] + float(variant.near):.3f} at range 0), "
        f"scales x {variant.stretch[0]:.2f} and {variant.stretch[1]:.2f}, "
        f"{variant.dof[0]:.2f} and {variant.dof[1]:.2f} degrees of freedom, tails to the power of {powers}"
    )
    return variant, recipe


def _fit_literal_variant(
    rows: DetectionTable, plan: FitPlan, _: str, report: Report
) -> tuple[Variant, Recipe | None]:
    from avrare_pem_training.fit_literal import LITERAL_SCHEDULE, fit_literal  # needs pyro

    columns, errors = features(rows, LITERAL), errors_in("ego", rows)
    mean, sd = columns.mean(axis=0), np.maximum(columns.std(axis=0), _MIN_SD)
    scale = np.maximum(errors[rows.detected].std(axis=0), _MIN_SCALE)
    sample = Sample((columns - mean) / sd, rows.detected, np.nan_to_num(errors / scale))
    latents = fit_literal(sample, replace(plan.schedule or LITERAL_SCHEDULE, seed=plan.seed), report)
    noise = scale * np.exp(latents.log_noise)
    report(f"normal noise of {noise[0]:.3f} m to the right and {noise[1]:.3f} m forward, not calibrated")
    variant = Variant(
        latents=latents,
        inputs=LITERAL,
        input_mean=mean,
        input_sd=sd,
        base_scale=np.stack([scale, np.zeros(2)], axis=1),
        dof=np.full(2, np.inf),
        limit=np.array(np.inf),
        link="probit",
        frame="ego",
        bounds=np.stack([columns.min(axis=0), columns.max(axis=0)]),
    )
    return variant, plan.recipe


def _fit_latents(
    sample: Sample, plan: FitPlan, distance: Floats, errors: Floats, report: Report
) -> tuple[Latents, UnseenRows, Recipe | None]:
    if plan.model == "gp":
        from avrare_pem_training.fit_gp import SCHEDULE, fit_gps  # needs pyro, networks do not

        schedule = replace(plan.schedule or SCHEDULE, seed=plan.seed)
        pair, mean, variance, rows = fit_gps(sample, schedule, report)
        unseen = UnseenRows(mean, variance, distance[rows], sample.detected[rows], errors[rows])
        return pair, unseen, plan.recipe
    recipe = plan.recipe or RECIPES[plan.model][0]
    fitted, left_out, fitted_recipe = fit_networks(sample, recipe, plan.seed, report)
    unseen = UnseenRows(left_out, np.zeros_like(left_out), distance, sample.detected, errors)
    return fitted, unseen, fitted_recipe


def fit_base_scale(distance: Floats, errors: Floats) -> Floats:
    """Return (2, 2) Student-t scales of both columns of ``errors`` (n, 2): at range 0, per metre of range."""

    def fit(error: Floats) -> Floats:
        def loss(parameters: Floats) -> float:
            base, slope, dof = np.exp(parameters)
            scale = np.maximum(base, _MIN_SCALE) + slope * distance
            return -float(student_t.logpdf(error, dof, scale=scale).mean())

        best = minimize(loss, np.log([0.05, 0.005, 2.5]), method="Nelder-Mead")
        parameters: Floats = np.maximum(np.exp(best.x[:2]), (_MIN_SCALE, 0.0))
        return parameters

    return np.stack([fit(errors[:, 0]), fit(errors[:, 1])])


def fit_yaw(rows: DetectionTable) -> YawErrors | None:
    """Fit the distribution of yaw errors; None where fewer than 100 rows have one."""
    measured = rows.detected & np.isfinite(rows.error_yaw)
    if measured.sum() < 100:
        return None
    distance = rows.range[measured]
    flipped, rest = separate_flips(rows.error_yaw[measured])

    def flip_loss(parameters: Floats) -> float:
        argument = parameters[0] + parameters[1] * distance / 50
        return float(
            np.logaddexp(0.0, np.where(flipped, -argument, argument)).mean() + 1e-4 * (parameters**2).sum()
        )

    flip = minimize(flip_loss, [-3.0, 1.0], method="Nelder-Mead").x / np.array([1.0, 50.0])
    spread = max(float(np.median(np.abs(rest))), 1e-3)

    def unpack(parameters: Floats) -> tuple[float, float, float]:
        base, slope, freedom = np.exp(np.clip(parameters, -20.0, 5.0))
        return base, slope, min(MIN_DOF + freedom, MAX_DOF)

    def rest_loss(parameters: Floats) -> float:
        base, slope, dof = unpack(parameters)
        return -float(student_t.logpdf(rest, dof, scale=base + slope * distance).mean())

    minimum = minimize(rest_loss, np.log([spread / 2, spread / 60, 1.5]), method="Nelder-Mead").x
    base, slope, dof = unpack(minimum)
    return YawErrors(flip, np.array([base, slope]), np.array(dof))
