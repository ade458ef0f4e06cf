"""The section of one rule: its numbers, how they came about, and how it fails."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from avrare.errors import AvrareError
from avrare.report.html import evidence
from avrare.report.html.drives import Drive, Shown, drive_again, select
from avrare.report.html.estimates import badge, number, percent
from avrare.report.html.folder import RunFolder
from avrare.report.html.markup import Markup, tag
from avrare.report.html.rollout import player


def sections(folder: RunFolder) -> list[Markup]:
    """One for each estimate, in the order of result.json."""
    shown = {name: _select(folder, name) for name in (one["specification"] for one in folder.estimates)}
    drives, trouble = _drives(folder, [one for several in shown.values() for one in several])
    found = []
    for index, entry in enumerate(folder.estimates):
        name = entry["specification"]
        mine = [one for one in drives if one.shown.specification == name]
        found.append(_section(folder, index, entry, mine, trouble if shown[name] else ()))
    return found


def _select(folder: RunFolder, name: str) -> list[Shown]:
    return select(name, folder.failures.get(name), folder.samples.get(name))


def _drives(folder: RunFolder, shown: Sequence[Shown]) -> tuple[list[Drive], tuple[str, ...]]:
    """Rollouts driven again; or why they cannot be."""
    if folder.scenario is None:
        return [], folder.trouble
    try:
        return drive_again(folder.scenario, shown), ()
    except AvrareError as error:
        return [], tuple(error.lines())


def _section(
    folder: RunFolder, index: int, entry: dict[str, Any], drives: Sequence[Drive], trouble: Sequence[str]
) -> Markup:
    head = tag("div", tag("h2", entry["specification"]), badge(entry["verdict"]), class_="head")
    return tag(
        "section", head, _formula(folder, entry["specification"]), _facts(entry), _health(entry),
        _evidence(folder, entry), _rollouts(folder, entry, drives, trouble),
        id=f"rule-{index}", class_="rule",
    )  # fmt: skip


def _formula(folder: RunFolder, name: str) -> Markup | None:
    if folder.scenario is None:
        return None
    formula = getattr(folder.scenario.stack.specifications.get(name), "formula", None)
    return None if formula is None else tag("pre", formula.text.strip(), class_="formula", tabindex=0)


def _facts(entry: dict[str, Any]) -> Markup:
    low, high = entry["interval"]
    error = entry["relative_error"]
    facts = [
        ("probability", number(entry["probability"])),
        (f"{percent(entry['confidence'])} interval", f"{number(low, 2)} – {number(high, 2)}"),
        ("relative error", "–" if error is None else percent(round(error, 3))),
        ("simulations", f"{entry['rollouts']:,}"),
        ("failures", f"{entry['failures']:,}"),
        ("broke down", f"{entry['errors']:,}"),
        ("time", f"{entry['seconds']:,.1f} s"),
    ]
    return tag("dl", [tag("div", tag("dt", name), tag("dd", value)) for name, value in facts], class_="facts")


def _health(entry: dict[str, Any]) -> Markup:
    """What should make one doubt the number, in plain words."""
    warnings = entry.get("warnings") or {}
    lines = [
        tag("li", tag("strong", name.replace("_", " ")), f": {text}.") for name, text in warnings.items()
    ]
    counts = {name: n for name, n in (entry.get("counts") or {}).items() if n and name != "solves"}
    for name, n in counts.items():
        lines.append(tag("li", f"{name.replace('_', ' ')}: {n:,} of {entry['counts'].get('solves', 0):,}."))
    if warnings:
        return tag("div", tag("h3", "What to doubt"), tag("ul", lines), class_="health doubt", role="note")
    clean = "No warnings: the checks of this estimator found nothing to doubt."
    return tag("div", tag("p", clean), tag("ul", lines) if lines else None, class_="health")


def _evidence(folder: RunFolder, entry: dict[str, Any]) -> Markup | None:
    sample = folder.samples.get(entry["specification"])
    robustness = np.zeros(0) if sample is None else sample.robustness.astype(np.float64)
    diagnostics = entry.get("diagnostics") or {}
    splitting = bool(diagnostics.get("levels"))
    figures = [evidence.histogram(robustness, splitting), evidence.convergence(entry, robustness)]
    gamma, label = _gamma(folder, entry) if splitting else (float, "")
    pair = tag("div", [one for one in figures if one is not None], class_="pair")
    return tag("div", pair, evidence.levels(diagnostics, gamma, label))


def _gamma(folder: RunFolder, entry: dict[str, Any]) -> tuple[Callable[[float], float], str]:
    """What to draw of a level: the robustness threshold of the papers, where the score can be told."""
    bare = float, "score"
    if folder.scenario is None:
        return bare
    try:
        problem, estimator = folder.scenario.problem(entry["specification"]), folder.scenario.estimator()
        prepare = getattr(estimator, "prepare", None)
        return (problem if prepare is None else prepare(problem)).gamma, "γ, 0 at failure"
    except AvrareError:  # the axis then says that it is the bare score
        return bare


def _rollouts(
    folder: RunFolder, entry: dict[str, Any], drives: Sequence[Drive], trouble: Sequence[str]
) -> Markup:
    if folder.scenario is None and trouble:
        return tag(
            "p", "Its stored rollouts are left out: the scenario cannot be built here.", class_="muted"
        )
    if trouble:
        text = "The stored rollouts could not be driven again, so there is no picture of them:"
        return tag("div", tag("p", text), tag("pre", "\n".join(trouble)), class_="note")
    if folder.scenario is None or not drives:
        return tag("p", "No rollout is stored in this folder.", class_="muted")
    return tag("div", [player(one, folder.scenario, k == 0) for k, one in enumerate(drives)])
