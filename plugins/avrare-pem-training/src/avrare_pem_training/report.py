"""Report of ``avrare pem fit``: model, model card in Markdown, scores and a picture."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

from avrare.base.errors import UsageError
from avrare_gp_pem.runtime.features import AXES
from avrare_gp_pem.runtime.store import save
from avrare_gp_pem.runtime.variant import FittedPem
from avrare_pem_training.cleaning import OBLIQUE, CleanedData
from avrare_pem_training.counts import count_events, misses_after_misses
from avrare_pem_training.ghost_log import describe_ghosts
from avrare_pem_training.persistence import NEARBY, describe_persistence
from avrare_pem_training.picture import draw
from avrare_pem_training.scores import AXIS_NAMES, TAILS, evaluate, yaw_scores

if TYPE_CHECKING:
    from avrare_pem_training.pipeline import FitPlan

Scores = Mapping[str, Mapping[str, float]]
"""Scores by part and name."""
TITLES = {
    "delivered": "labels, as delivered",
    "clean": "detector, clean rows",
    "clean_on_delivered": "detector, rows as delivered",
}
_KINDS = {
    "gp": "two sparse variational Gaussian processes (detection; location and log scale of Student-t errors)",
    "mlp": "the mean of small networks (detection and Student-t errors from one trunk)",
    "student": "logistic detection, Student-t errors whose location and log scale are linear in the inputs",
    "literal": "two sparse variational Gaussian processes of seven inputs, with normal errors: that of the "
    "STL-AMS paper",
    "logistic": "logistic detection, and Student-t errors with a scale linear in range: a baseline",
}


def provenance(plan: FitPlan, data: CleanedData, given: Mapping[str, str]) -> dict[str, str]:
    """Return the statements of a model file about its origin: data, rows, seed, versions and licence."""
    rows = f"{len(data.train)} training ({int(data.oblique.sum())} of them clean), {len(data.test)} held out"
    libraries = ["torch", "numpy", "scipy", *(["pyro-ppl"] if plan.model in ("gp", "literal") else [])]
    return {
        **given,
        "model": plan.model,
        "rows": rows,
        "artefact of matching": "modelled apart" if data.has_artefact else "none",
        "seed": str(plan.seed),
        "fitted with": ", ".join(f"{name} {version(name)}" for name in ("avrare-gp-pem", *libraries)),
    }


def write_report(folder: Path, name: str, model: FittedPem, data: CleanedData) -> list[str]:
    """Write NAME.npz, NAME.md, NAME.json and NAME.png; return lines for the terminal.

    Raises:
        UsageError: A file cannot be written.
    """
    scored, yaw = evaluate(model, data), yaw_scores(model, data)
    scores = {part: rows.scores for part, rows in scored.items()}
    paths = [folder / f"{name}.{ending}" for ending in ("npz", "md", "json", "png")]
    try:
        save(paths[0], model)
        paths[1].write_text(_render_card(name, model, data, scores, yaw), encoding="utf-8")
        paths[2].write_text(as_json(scores | {"yaw": yaw}) + "\n", encoding="utf-8")
        draw(paths[3], f"{name}: {model.provenance.get('model', '')} on held-out rows", scored)
    except OSError as error:
        raise UsageError(f"{error.filename or folder}: cannot be written: {error.strerror}") from None
    return [*summary(scores), *(f"wrote {path}" for path in paths)]


def as_json(scores: Scores) -> str:
    """Return scores as a JSON object; a number that is not finite becomes null."""
    finite = {
        part: {name: value if math.isfinite(value) else None for name, value in s.items()}
        for part, s in scores.items()
    }
    return json.dumps(finite, indent=2)


def summary(scores: Scores) -> Iterator[str]:
    """Yield the main scores as lines."""
    for part, s in scores.items():
        yield (
            f"{TITLES[part]}: detection NLL {s['detection_nll']:.4f} (base {s['detection_base_nll']:.4f}), "
            f"AUC {s['detection_auc']:.3f}, ECE {s['detection_calibration_error']:.4f}"
        )
        for name in _error_names(s):
            yield (
                f"  error {name}: NLL {s[f'{name}_nll']:.4f}, P(|z| > 4) {100 * s[f'{name}_z4']:.2f} %, "
                f"the model's own {100 * s[f'{name}_z4_own']:.2f} %"
            )


def _error_names(scores: Mapping[str, float]) -> list[str]:
    return [name for names in AXIS_NAMES.values() for name in names if f"{name}_nll" in scores]


def _render_card(
    name: str, model: FittedPem, data: CleanedData, scores: Scores, yaw: Mapping[str, float]
) -> str:
    facts = "".join(f"| {key} | {value} |\n" for key, value in model.provenance.items())
    parts = [
        f"# {name}: model card\n",
        f"A perception error model: {_KINDS.get(model.provenance.get('model', ''), 'a fit')}.\n",
        f"| | |\n|---|---|\n{facts}",
        "## Held-out rows\n",
        f"The last fifth of the rows, as a block ({len(data.test):,} rows), which the fit has not seen.\n",
        _render_detection(scores),
        _render_errors(model, scores),
        _render_counts(model, data),
        *([_render_yaw(yaw)] if yaw else []),
        "## Limits\n",
        _render_limits(model, data),
    ]
    return "\n".join(parts)


def _render_detection(scores: Scores) -> str:
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


def _render_errors(model: FittedPem, scores: Scores) -> str:
    head = " | ".join(f"P(\\|z\\| > {size:g})" for size in TAILS)
    lines = [
        "Errors (NLL in nats, errors in metres; shares beyond k scales of the law and, last, beyond 4 of its",
        "standard deviations: observed / the law's own):\n",
        f"| | error | rows | NLL | dof | {head} | beyond 4 sd |",
        "|---|---|---|---|---|" + "---|" * (len(TAILS) + 1),
    ]
    for part, s in scores.items():
        for name in _error_names(s):
            tails = [(s[f"{name}_z{size:g}"], s[f"{name}_z{size:g}_own"]) for size in TAILS]
            tails.append((s[f"{name}_4sd"], s[f"{name}_4sd_own"]))
            cells = " | ".join(f"{100 * seen:.2f} / {100 * modelled:.2f} %" for seen, modelled in tails)
            lines.append(
                f"| {TITLES[part]} | {name} | {s['error_rows']:,.0f} | **{s[f'{name}_nll']:.4f}** | "
                f"{s[f'{name}_dof']:.2f} | {cells} |"
            )
    return "\n".join(lines) + "\n"


def _render_counts(model: FittedPem, data: CleanedData) -> str:
    parts = [data.train.take(data.oblique), data.test.take(data.test_oblique)]
    events = zip(*(count_events(model, rows) for rows in parts), strict=True)
    lines = [
        "Large errors and misses of the detector, counted in clean rows: seen / expected by the law.\n",
        "| | training rows | | held-out rows | |",
        "|---|---|---|---|---|",
    ]
    for pair in events:
        cells = " | ".join(f"{count.rows:,} | **{count.seen}** / {count.expected:.1f}" for count in pair)
        lines.append(f"| {pair[0].what} | {cells} |")
    after = misses_after_misses(model, parts[1])
    if after:
        lines += [
            f"\nHeld-out clean rows within {NEARBY:g} m, share missed some time after a miss:\n",
            "| | pairs | seen | errors drawn anew | measured persistence |",
            "|---|---|---|---|---|",
        ]
    lines += [
        f"| {share.seconds:g} s | {share.pairs} | **{share.seen:.2f}** | {share.anew:.2f} "
        f"| {share.lasting:.2f} |"
        for share in after
    ]
    return "\n".join(lines) + "\n"


def _render_yaw(yaw: Mapping[str, float]) -> str:
    rows, seen, modelled = yaw["yaw_rows"], 100 * yaw["yaw_flips"], 100 * yaw["yaw_flips_own"]
    return (
        f"Yaw ({rows:,.0f} clean detections): {seen:.1f} % are off by half a turn, the model says "
        f"{modelled:.1f} %; the rest has a median of {yaw['yaw_rest_median']:.3f} rad; "
        f"NLL {yaw['yaw_nll']:.3f}.\n"
    )


def _render_limits(model: FittedPem, data: CleanedData) -> str:
    bounds = dict(zip(model.clean.inputs, model.clean.bounds.T, strict=True))
    spans = [(name, *bounds[name]) for name in ("range", "length", "width") if name in bounds]
    spans_text = ", ".join(f"{name} {low:.1f} to {high:.1f}" for name, low, high in spans)
    lines = [
        _render_artefact(model, data),
        f"It has seen {spans_text} m; beyond, inputs are cut to these: it extrapolates nothing.",
        _render_persistence(model),
        _render_ghosts(model, data),
        "No swapped identities; errors of size are not modelled.",
        "The data has no speeds: their error is an option of the scenario, not of this model.",
    ]
    return "".join(f"* {line}\n" for line in lines)


def _render_persistence(model: FittedPem) -> str:
    if model.persistence is None:
        return "Errors are drawn anew at every step: runs of misses are probably too short."
    measured = describe_persistence(model.persistence).removeprefix("persistence: ")
    return (
        f"Errors last as in the training rows ({measured}) only with `persistence: measured`; over times "
        "shorter than between two frames this is extrapolated."
    )


def _render_ghosts(model: FittedPem, data: CleanedData) -> str:
    measured = describe_ghosts(model.ghosts, data.ghosts, data.test_ghosts).capitalize()
    if model.ghosts is None:
        return f"{measured}."
    places = len(model.ghosts.points)
    return f"{measured}. Only with `ghosts: measured`; the file holds {places} of their places."


def _render_artefact(model: FittedPem, data: CleanedData) -> str:
    if not data.has_artefact:
        return "No artefact of matching by axis-aligned boxes is modelled: one law for all rows."
    if not data.artefact.is_measured:
        return (
            "As requested, vehicles along the axes of the ego count as affected by an artefact of matching."
        )
    aligned, oblique = 100 * data.artefact.aligned, 100 * data.artefact.oblique
    rows, every = int(data.oblique.sum()), len(data.train)
    read = [name for name in AXES if model.delivered is not None and name in model.delivered.inputs]
    also = f" also read {', '.join(read)}" if read else " read nothing of its own"
    return (
        "The labels have the artefact of matching by axis-aligned boxes: within 1 degree of an axis of the "
        f"ego {aligned:.0f} % are detected, {OBLIQUE:g} degrees or more off it {oblique:.0f} % at the same "
        f"range below 50 m. The detector (`artefact: false`) is learnt from these, {rows:,} of {every:,}, "
        "so aligned traffic lies between its rows and no label can check it; the labels as delivered "
        f"(`artefact: true`){also}."
    )
