"""The model card of a fit, in Markdown: data, licence, how well it predicts, and its limits."""

from __future__ import annotations

from collections.abc import Mapping

from avrare_gp_pem.clean import OBLIQUE, Cleaned
from avrare_gp_pem.features import AXES
from avrare_gp_pem.scores import NAMES, TAILS
from avrare_gp_pem.store import FittedPem

_KINDS = {
    "gp": "two sparse variational Gaussian processes (detection; location and log scale of Student-t errors)",
    "mlp": "the mean of small networks (detection and Student-t errors from one trunk)",
    "student": "logistic detection, Student-t errors whose location and log scale are linear in the inputs",
    "logistic": "logistic detection, and Student-t errors with a scale linear in range: a baseline",
}


def card(
    name: str,
    model: FittedPem,
    data: Cleaned,
    scores: Mapping[str, Mapping[str, float]],
    yaw: Mapping[str, float],
) -> str:
    """The card of ``model``.

    Args:
        name: Of the model.
        model: The fit.
        data: What it was fitted to and scored on.
        scores: Scores by part, with the titles in ``TITLES``.
        yaw: Those of the yaw's errors; may be empty.
    """
    parts = [
        f"# {name}: model card\n",
        f"A perception error model: {_KINDS.get(model.provenance.get('model', ''), 'a fit')}.\n",
        _facts(model),
        "## Held-out rows\n",
        f"The last fifth of the rows, as a block ({len(data.test):,} rows), which the fit has not seen.\n",
        _detection(scores),
        _errors(model, scores),
        *([_yaw(yaw)] if yaw else []),
        "## Limits\n",
        _limits(model, data),
    ]
    return "\n".join(parts)


TITLES = {
    "delivered": "labels, as delivered",
    "clean": "detector, clean rows",
    "clean_on_delivered": "detector, rows as delivered",
}


def _facts(model: FittedPem) -> str:
    rows = "".join(f"| {key} | {value} |\n" for key, value in model.provenance.items())
    return f"| | |\n|---|---|\n{rows}"


def _detection(scores: Mapping[str, Mapping[str, float]]) -> str:
    lines = [
        "Detection:\n",
        "| | rows | base NLL | NLL | AUC | Brier | ECE |",
        "|---|---|---|---|---|---|---|",
    ]
    for part, s in scores.items():
        lines.append(
            f"| {TITLES[part]} | {s['detection_rows']:,.0f} | {s['detection_base_nll']:.4f} | "
            f"**{s['detection_nll']:.4f}** | {s['detection_auc']:.4f} | {s['detection_brier']:.4f} | "
            f"{s['detection_calibration_error']:.4f} |"
        )
    return "\n".join(lines) + "\n"


def _errors(model: FittedPem, scores: Mapping[str, Mapping[str, float]]) -> str:
    head = " | ".join(f"P(\\|z\\| > {size:g})" for size in TAILS)
    lines = [
        "Errors (NLL in nats, errors in metres; shares beyond k scales of the law and, last, beyond 4 of its",
        "standard deviations: observed / the law's own):\n",
        f"| | error | rows | NLL | dof | {head} | beyond 4 sd |",
        "|---|---|---|---|---|" + "---|" * (len(TAILS) + 1),
    ]
    for part, s in scores.items():
        for name in (name for names in NAMES.values() for name in names if f"{name}_nll" in s):
            tails = [(s[f"{name}_z{size:g}"], s[f"{name}_z{size:g}_own"]) for size in TAILS]
            tails.append((s[f"{name}_4sd"], s[f"{name}_4sd_own"]))
            cells = " | ".join(f"{100 * seen:.2f} / {100 * own:.2f} %" for seen, own in tails)
            lines.append(
                f"| {TITLES[part]} | {name} | {s['error_rows']:,.0f} | **{s[f'{name}_nll']:.4f}** | "
                f"{s[f'{name}_dof']:.2f} | {cells} |"
            )
    return "\n".join(lines) + "\n"


def _yaw(yaw: Mapping[str, float]) -> str:
    rows, seen, own = yaw["yaw_rows"], 100 * yaw["yaw_flips"], 100 * yaw["yaw_flips_own"]
    return (
        f"Yaw ({rows:,.0f} clean detections): {seen:.1f} % are off by half a turn, the model says "
        f"{own:.1f} %; the rest has a median of {yaw['yaw_rest_median']:.3f} rad; NLL {yaw['yaw_nll']:.3f}.\n"
    )


def _limits(model: FittedPem, data: Cleaned) -> str:
    lines = [
        _artefact(data),
        f"It has seen {', '.join(_seen(model))} m; beyond, inputs are cut to these: it extrapolates nothing.",
        "Errors are drawn anew at every step: runs of misses are probably too short.",
        "No false positives and no swapped identities; errors of size are not modelled.",
        "The data has no speeds: their error is an option of the scenario, not of this model.",
    ]
    return "".join(f"* {line}\n" for line in lines)


def _artefact(data: Cleaned) -> str:
    if not data.has_artefact:
        return "No artefact of matching by axis-aligned boxes is modelled: one law for all rows."
    if not data.artefact.known:
        return (
            "Vehicles along the axes of the ego were taken for touched by an artefact of matching, as told."
        )
    aligned, oblique = 100 * data.artefact.aligned, 100 * data.artefact.oblique
    rows, every = int(data.oblique.sum()), len(data.train)
    return (
        "The labels have the artefact of matching by axis-aligned boxes: within 1 degree of an axis of the "
        f"ego {aligned:.0f} % are detected, {OBLIQUE:g} degrees or more off it {oblique:.0f} % at the same "
        f"range below 50 m. The detector (`artefact: false`) is learnt from these, {rows:,} of {every:,}, "
        "so aligned traffic lies between its rows and no label can check it; the labels as delivered "
        f"(`artefact: true`) also read {', '.join(AXES)}."
    )


def _seen(model: FittedPem) -> list[str]:
    spans = dict(zip(model.clean.inputs, model.clean.bounds.T, strict=True))
    known = [name for name in ("range", "length", "width") if name in spans]
    return [f"{name} {spans[name][0]:.1f} to {spans[name][1]:.1f}" for name in known]
