"""Figures 3 and 4 of the paper again: cross-entropy over its stages, splitting's levels for each K."""

from __future__ import annotations

from pathlib import Path

from studies.figures import make_axes
from studies.table2_page import RULES, Study

COLOURS = dict(zip(RULES, ("#1b6ca8", "#d9701a", "#3d8b5f", "#8a4f9e"), strict=True))
NAMES = {
    "safe_distance": "safe distance (R_G1)", "no_abrupt_braking": "no abrupt braking (R_G2)",
    "traffic_flow": "traffic flow (R_G4)", "left_traffic": "left traffic (R_I2)",
}  # fmt: skip
DISCARDS = (2, 25, 125, 225)


def draw(study: Study, folder: Path) -> None:
    """Write figure3.png and figure4.png, as far as their cells have run."""
    folder.mkdir(exist_ok=True)
    if any((rule, "Imp-CE") in study.outcomes for rule in RULES):
        _stages(study, folder / "figure3.png")
    if any((rule, f"K{discard}") in study.outcomes for rule in RULES for discard in DISCARDS):
        _levels(study, folder / "figure4.png")


def _stages(study: Study, file: Path) -> None:
    """Draw margin left, estimate and failures of each stage of learning, first repetition of each rule."""
    figure, axes = make_axes(12.0, 3.6, 3)
    for ax in axes:
        ax.grid(alpha=0.25)
    for rule in RULES:
        found = study.outcomes.get((rule, "Imp-CE"))
        if not found:
            continue
        stages = found[0]["diagnostics"]["stages"][0]
        number = range(1, len(stages) + 1)
        style = {"color": COLOURS[rule], "marker": "o", "ms": 3.5, "lw": 1.3, "label": NAMES[rule]}
        axes[0].plot(number, [1.0 - stage["level"] for stage in stages], **style)
        shares = [stage["probability"] for stage in stages]
        axes[1].plot(number, [share if share else float("nan") for share in shares], **style)
        axes[2].plot(number, [stage["failures"] for stage in stages], **style)
        axes[1].axhline(study.truth[rule]["probability"], color=COLOURS[rule], lw=0.8, ls="--")
    axes[0].set(title="margin left at the elite's threshold", xlabel="stage", ylim=(0.0, None))
    axes[1].set(title="estimate of the stage (dashed: truth)", xlabel="stage", yscale="log")
    axes[2].set(title="failures of 250", xlabel="stage")
    axes[0].legend(fontsize=7.5, frameon=False)
    figure.savefig(file, dpi=110)


def _levels(study: Study, file: Path) -> None:
    """Draw the remaining share of the noise-free margin at each stage's level, one run of each discard."""
    there = [number for number in DISCARDS if any((rule, f"K{number}") in study.outcomes for rule in RULES)]
    figure, axes = make_axes(4.0 * len(there), 3.6, len(there))
    for ax, discard in zip(axes, there, strict=True):
        ax.grid(alpha=0.25)
        for rule in RULES:
            found = study.outcomes.get((rule, f"K{discard}"))
            if not found:
                continue
            levels = found[0]["diagnostics"]["levels"][0]
            number = range(1, len(levels) + 1)
            dead = "" if found[0]["probability"] else ", died out"
            ax.plot(
                number, [1.0 - level for level in levels], color=COLOURS[rule], lw=1.3,
                label=NAMES[rule] + dead, marker="o" if len(levels) < 40 else "", ms=3.0,
            )  # fmt: skip
        ax.axhline(0.0, color="#22303c", lw=0.8)
        ax.set(title=f"K = {discard}", xlabel="stage", ylim=(-0.03, 1.03))
        ax.xaxis.get_major_locator().set_params(integer=True)
        ax.legend(fontsize=7, frameon=False)
    axes[0].set_ylabel("margin left at the level")
    figure.savefig(file, dpi=110)
