"""Strips of a player: predicates and noise over time as rows of shares of full colour."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import islice, product

import numpy as np

from avrare.analysis.monitor.monitoring import MonitoringResult, list_vehicle_names, select_inputs
from avrare.analysis.page.model import Strip, Strips
from avrare.base.errors import FormulaError
from avrare.logic.formula import find_formula
from avrare.logic.syntax import nodes
from avrare.logic.syntax.printer import to_text
from avrare.protocols import Floats, Specification
from avrare.rollout.problem import Problem
from avrare.stack.closed_loop import ClosedLoop

_MAX_ROWS = 24
_FULL_OPACITY = 3.0  # magnitude of a standard normal number drawn fully opaque


def draw_predicates(specification: Specification, result: MonitoringResult) -> Strips | None:
    """Return a strip for each predicate that changes over time; None if there are none."""
    predicates = evaluate_predicates(specification, result)
    changing = {text: values for text, values in predicates.items() if len(np.unique(values)) > 1}
    if not changing:
        return None
    rows = []
    for text, values in islice(changing.items(), _MAX_ROWS):
        finite = np.abs(values[np.isfinite(values)])
        largest = float(finite.max()) if len(finite) and finite.max() > 0.0 else 1.0
        description = f"{text}: holds at {int((values > 0).sum())} of {len(values)} samples"
        rows.append(Strip(text, description, shade(values[None], largest), 0.3, 14))
    hidden, constant = len(changing) - len(rows), len(predicates) - len(changing)
    note = f"; {constant} constant ones are not shown" if constant else ""
    note += f"; {hidden} more are not shown" if hidden > 0 else ""
    key = ("box positive", "holds"), ("box negative", "does not hold")
    return Strips("Predicates", tuple(rows), key, f"darker: further from the bound{note}")


def draw_noise(problem: Problem, tape: Floats, failed: bool) -> Strips | None:
    """Return the strips of a noise tape (steps + 1, noise_size); None for a system without noise."""
    if not tape.shape[1]:
        return None
    rows = []
    groups = _group_channels(problem, tape.shape[1])
    for label, first, last in groups[:_MAX_ROWS]:
        channels = tape[:, first:last].T
        description = f"Noise of {label}, {channels.shape[0]} channels over {channels.shape[1]} steps, up to "
        description += f"{np.abs(channels).max():.2f} standard deviations"
        rows.append(
            Strip(label, description, shade(channels, _FULL_OPACITY), 0.0, max(11 * len(channels), 14))
        )
    hidden = len(groups) - len(rows)
    key = ("box positive", "+3 standard deviations"), ("box negative", "−3")
    note = f"{hidden} more rows are not shown" if hidden > 0 else "a row for each channel"
    caption = "Noise that caused the failure" if failed else "Noise"
    return Strips(caption, tuple(rows), key, note)


def evaluate_predicates(specification: Specification, result: MonitoringResult) -> dict[str, Floats]:
    """Map the predicates of a formula, in its order, to their robustness (T,); none without a formula.

    A variable stands for the vehicle that decides; without one there is a series for each vehicle.
    """
    formula = find_formula(specification)
    if formula is None:
        return {}
    try:
        values = formula.parts(select_inputs(specification, result.recording))
    except FormulaError:
        return {}
    names = list_vehicle_names(specification, result.recording)
    decisive = result.first or result.worst
    chosen = decisive.vehicles if decisive is not None else {}
    rows: dict[str, Floats] = {}
    for node, quantifiers in _list_predicates(formula.node, ()):
        array = values[to_text(node)][0]
        for label, row in select_rows(to_text(node), array, quantifiers, names, chosen):
            rows.setdefault(label, row)
    return rows


def _list_predicates(
    node: nodes.Node, outer: tuple[nodes.Quantifier, ...]
) -> Iterator[tuple[nodes.Node, tuple[nodes.Quantifier, ...]]]:
    # each with the quantifiers around it
    inner = (*outer, node) if isinstance(node, nodes.Quantifier) else outer
    children = nodes.children(node)
    if not children:
        yield node, outer
    for child in children:
        yield from _list_predicates(child, inner)


def select_rows(
    predicate: str,
    array: Floats,
    quantifiers: Sequence[nodes.Quantifier],
    names: Sequence[str],
    chosen: Mapping[str, str],
) -> Iterator[tuple[str, Floats]]:
    """Yield a predicate with its values (T,) for each choice of vehicles.

    ``array`` (T, ...) has an axis for each quantifier around the predicate. ``chosen`` maps variables to the
    vehicles that decide; for other variables there is a row for each of the vehicles ``names``.
    """
    sizes = array.shape[1:]
    axes = []
    for quantifier, size in zip(quantifiers, sizes, strict=False):
        vehicle = chosen.get(quantifier.variable)
        members = list(names) if len(names) == size else [str(k) for k in range(size)]
        chosen_members = [members.index(vehicle)] if vehicle in members and size > 1 else range(size)
        axes.append([(quantifier.variable, members[k] if size > 1 else None, k) for k in chosen_members])
    for choice in product(*axes):
        bound = {variable: member for variable, member, _ in choice if member is not None}
        words = re.split(r"\b([A-Za-z_]\w*)\b", predicate)
        label = "".join(bound.get(word, word) for word in words)
        yield label, np.moveaxis(array, 0, -1)[tuple(k for _, _, k in choice)]


def _group_channels(problem: Problem, size: int) -> list[tuple[str, int, int]]:
    # (label, first, last + 1): the channels of draws come first, of the simulator, then of the perception
    # model, which are taken to be ordered by vehicle if there are equally many for each.
    loop = problem.system
    if not isinstance(loop, ClosedLoop):
        return [("simulator", 0, size)]
    drawn, world = loop.world_noise - loop.simulator.noise_size, loop.world_noise
    groups = [("draws, at the start", 0, drawn)] if drawn else []
    groups += [("simulator", drawn, world)] if world > drawn else []
    names = problem.scene.names if problem.scene is not None else ()
    each, rest = divmod(size - world, max(len(names), 1))
    if size == world:
        return groups
    if not names or rest:
        return [*groups, ("perception", world, size)]
    return groups + [
        (f"perception of {name}", world + v * each, world + (v + 1) * each) for v, name in enumerate(names)
    ]


def shade(values: Floats, largest: float) -> tuple[tuple[float, ...], ...]:
    """Return values (rows, columns) as signed shares of ``largest``, at most 1; 0 for NaN."""
    with np.errstate(invalid="ignore"):
        shares = np.nan_to_num(np.clip(values / largest, -1.0, 1.0))
    return tuple(tuple(row) for row in shares.tolist())
