"""Scope: what the cells are, what is missing among them, and what so many can tell. All of it is counted."""

from __future__ import annotations

import math
import re
import statistics
from collections import Counter
from collections.abc import Iterable, Sequence

from scipy import stats

from benchmarks.calibration.problems import problems
from benchmarks.calibration.summary import LEAST_ANSWERS, Row, far_off
from benchmarks.calibration.tools import RECOMMENDED, TOOLS, Tool

BUDGETS = (1_000, 10_000, 100_000)
"""Budgets of the full run."""
_SEEDS, _DEAR_SEEDS, _LARGE = 10, 3, 100_000
"""Answers of a tool to a problem, those where they are dear, and the budget from which on there is one."""
FEW = 10
"""Dimensions that are few."""
_NAMED, _LONG = 5, 120
"""Problems that are named, and characters of a reason."""


def planned(tool: Tool, setting: str, budget: int) -> int:
    """Return the answers of a tool to a problem in the full run: fewer where they are dear or a variant's."""
    if setting != RECOMMENDED or budget >= _LARGE:
        return 1
    return _DEAR_SEEDS if budget >= tool.dear else _SEEDS


def possible() -> int:
    """Return the number of answers of the full run."""
    return sum(
        planned(tool, setting, budget) * sum(not tool.unable(problem) for problem in problems().values())
        for tool in TOOLS.values() for setting in tool.settings for budget in BUDGETS
    )  # fmt: skip


def typical_seeds(rows: Sequence[Row]) -> int:
    """Return the median number of answers of a tool on a problem."""
    return int(statistics.median_low(len(row.cells) for row in rows))


def resolution(seeds: int) -> dict[str, str]:
    """Return what cannot be told from so many answers, at 95 %.

    Returns:
        ``least``: true coverage that may hide behind intervals that all hold; ``wrong``: share of wrong
        answers behind none.
    """
    least = 0.05 ** (1.0 / seeds)
    return {"seeds": _answers(seeds), "least": f"{least:.0%}", "wrong": f"{1.0 - least:.0%}"}


def order(seeds: int) -> dict[str, str]:
    """Return the ratio of two costs that chance explains, at 95 %, for errors that are normal."""
    return {"first_seeds": _answers(seeds), "factor": f"{float(stats.f.ppf(0.975, seeds, seeds)):.1f}"}


def _answers(count: int) -> str:
    return f"{count} answer{'s' if count > 1 else ''}"


def cells_text(rows: Sequence[Row], shown: Sequence[Row]) -> str:
    """Return how many answers there are, of what, and what share of the full run."""
    total, counts = sum(_counted(row) for row in rows), [_counted(row) for row in shown]
    share = total / possible()
    few, many = min(counts), max(counts)
    part = f"{share:.0%}" if share >= 0.01 else "less than 1 %"
    of_all = f"{total:,} of the {possible():,} answers of the full run ({part})"
    text = (
        f"**These are {of_all if total < possible() else f'all {total:,} answers of the full run'}.** "
        f"The budget of {shown[0].budget:,} evaluations, in the setting *{RECOMMENDED}*, has {few} to {many} "
        f"answers of a tool on a problem, mostly {typical_seeds(shown)}; "
        "figures and *Who is first* are of these."
    )
    others = Counter({
        (row.setting, row.budget): sum(_counted(one) for one in rows if _group(one) == _group(row))
        for row in rows if _group(row) != _group(shown[0])
    })  # fmt: skip
    if others:
        listed = ", ".join(f"{n:,} of *{s}* at {b:,}" for (s, b), n in sorted(others.items()))
        text += f" The others are {listed}."
    return text


def missing_text(rows: Sequence[Row], shown: Sequence[Row]) -> str:
    """Return what was not run: settings and budgets, and problems that a tool has not met."""
    run = {_group(row) for row in rows}
    settings = sorted({setting for tool in TOOLS.values() for setting in tool.settings})
    absent = [f"*{s}* at {b:,}" for s in settings for b in BUDGETS if (s, b) not in run]
    gaps = []
    for tool in TOOLS.values():
        able = [one for one in problems().values() if not tool.unable(one)]
        met = {row.problem.name for row in shown if row.tool == tool.name}
        if len(met) < len(able):
            gaps.append(f"`{tool.name}` {len(able) - len(met)} of {len(able)}")
    text = f"Nothing yet of {', '.join(absent)}. " if absent else ""
    if gaps:
        text += f"Problems that a tool was not asked yet, of those that it can express: {', '.join(gaps)}. "
    met = {row.tool for row in shown}
    if silent := sorted(met - {row.tool for row in shown if row.answers}):
        names = " and ".join(f"`{name}`" for name in silent)
        text += (
            f"No answer of {names} at {shown[0].budget:,}, for the reasons "
            "[below](#where-there-was-no-answer): not judged. "
        )
    return text.rstrip() or "Nothing is missing."


def truth_text() -> str:
    """Return how exact the truths are that are no formula's."""
    errors = [one.error / one.probability for one in problems().values() if one.error]
    return (
        f"{len(errors)} problems have truths by brute force, with errors of {min(errors):.1%} to "
        f"{max(errors):.1%}, which the error of the means includes and coverage does not."
    )


def warned_text(shown: Sequence[Row]) -> str:
    """Return how often each tool warns, of what, how many of these are far off, and what covers unwarned."""
    lines = []
    for tool in dict.fromkeys(row.tool for row in shown):
        rows = [row for row in shown if row.tool == tool]
        own = [cell for row in rows for cell in row.cells]
        warned = [cell for cell in own if cell.warnings]
        off = sum(far_off(one, row.problem.probability) for row in rows for one in row.cells if one.warnings)
        kinds = Counter(name for cell in warned for name in cell.warnings).most_common(3)
        if warned:
            named = ", ".join(f"`{name}` {count / len(own):.0%}" for name, count in kinds)
            share = f"{len(warned) / len(own):.0%}"
            quiet = _unwarned_text(rows)
            lines.append(f"`{tool}` of {share} ({named}; far off {off} of {len(warned)}{quiet})")
    if not lines:
        return "No tool warned of an answer."
    return f"Warned of: {'; '.join(lines)}. The others never warned."


def _unwarned_text(rows: Sequence[Row]) -> str:
    """Return how many intervals hold the truth where the tool did not warn."""
    held = [
        cell.low <= row.problem.probability <= cell.high
        for row in rows for cell in row.cells
        if not cell.warnings and cell.low is not None and cell.high is not None
    ]  # fmt: skip
    return f"; unwarned intervals cover {sum(held) / len(held):.1%} of {len(held)}" if held else ""


def wins_lines(winners: Iterable[tuple[str, str]], peers: Sequence[Row]) -> list[str]:
    """Return, for each tool, the problems on which it is first.

    Args:
        winners: Pairs of problem and tool.
        peers: Rows that were compared; a tool with too few answers in each could not be first.
    """
    found: dict[str, list[str]] = {}
    for problem, tool in winners:
        found.setdefault(tool, []).append(problem)
    judged = {row.tool for row in peers if len(row.cells) >= LEAST_ANSWERS}
    without = [name for name in TOOLS if name in judged and name not in found]
    unjudged = [name for name in TOOLS if name not in judged]
    lines = [f"- {tool}: {', '.join(found[tool])}." for tool in TOOLS if tool in found]
    lines += [f"- First nowhere: {', '.join(without)}."] if without else []
    return lines + ([f"- Not judged, for want of answers: {', '.join(unjudged)}."] if unjudged else [])


def silent_lines(shown: Sequence[Row]) -> list[str]:
    """Return why tools gave no answer, and where."""
    found: dict[tuple[str, str], list[str]] = {}
    for row in shown:
        for reason in dict.fromkeys(_short(cell.cause) for cell in row.cells if cell.reason):
            found.setdefault((row.tool, reason), []).append(row.problem.name)
    if not found:
        return ["Every tool had an answer wherever it was asked."]
    limits = [cell.patience for row in shown for cell in row.cells if math.isfinite(cell.patience)]
    given = _limits_text(limits) if limits else ""
    lines = [f"N stands for a number that differs.{given}", ""]
    lines += ["| tool | no answer, as | problems | such as |", "|---|---|---|---|"]
    for (tool, reason), names in found.items():
        lines.append(f"| {tool} | {reason} | {len(names)} | {', '.join(names[:_NAMED])} |")
    return lines


def _limits_text(limits: Sequence[float]) -> str:
    return (
        f" Time was up after {min(limits):.0f} to {max(limits):.0f} CPU seconds; "
        "what took more than a fifth of that at a tenth of the budget was not asked, and what was given up "
        "at its first seed was not asked again, and counts as given up at every seed."
    )


def dimension_lines(shown: Sequence[Row]) -> list[str]:
    """Return coverage and confidently wrong shares in few and in many dimensions."""
    lines = [
        f"| tool | covers, d <= {FEW} | confidently wrong | covers, d > {FEW} | confidently wrong |",
        "|---|---|---|---|---|",
    ]
    for tool in dict.fromkeys(row.tool for row in shown):
        entries = []
        for few in (True, False):
            own = [row for row in shown if row.tool == tool and (row.problem.dimension <= FEW) is few]
            stated, cells = (sum(len(group) for group in kind) for kind in _cells(own))
            covered = sum(row.covers * len(row.stated) for row in own if row.stated)
            wrong = sum(row.wrong for row in own)
            entries += [f"{covered / stated:.0%} of {stated}" if stated else ""]
            entries += [f"{wrong / cells:.1%} of {cells}" if cells else ""]
        lines.append(f"| {tool} | {' | '.join(entries)} |")
    return lines


def _cells(rows: Sequence[Row]) -> tuple[list[Sequence[object]], list[Sequence[object]]]:
    return [row.stated for row in rows], [row.cells for row in rows]


def _short(reason: str) -> str:
    """Return the reason without its numbers, which differ from seed to seed."""
    text = " ".join(
        re.sub(r"[-+]?[0-9][0-9.,e+-]*", "N", reason.replace("|", "/")).split(" at point ")[0].split()
    )
    return text if len(text) <= _LONG else text[:_LONG].rsplit(" ", 1)[0] + " ..."


def _counted(row: Row) -> int:
    """Return the answers of a row that are of the full run: some have been made for other studies."""
    return min(len(row.cells), planned(TOOLS[row.tool], row.setting, row.budget))


def _group(row: Row) -> tuple[str, int]:
    return row.setting, row.budget
