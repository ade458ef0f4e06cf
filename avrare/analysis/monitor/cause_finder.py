"""Sample, vehicles and sub-formula that decide a formula on a recorded drive."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrare.logic.explanation import Cause, Explanation, Link
from avrare.logic.formula import Formula
from avrare.logic.syntax import nodes
from avrare.protocols import Floats

Inputs = Mapping[str, NDArray[Any]]


@dataclass(frozen=True)
class DecisiveSample:
    """Sample of a drive with the vehicles and the sub-formula that decide a formula there."""

    sample: int
    robustness: float  # of the specification
    vehicles: dict[str, str]  # quantified variable -> vehicle that decides
    formula: str  # deciding sub-formula, with the names of the vehicles; empty if unknown
    value: float  # robustness of the sub-formula
    formula_sample: int  # where the sub-formula has it: another sample if the formula looks ahead or back
    # Variables for which one vehicle is enough: if the specification is violated, theirs comes nearest.
    existential: tuple[str, ...] = ()
    limit: str = ""  # sub-formula that has the specification's robustness, where it is not ``formula``


@dataclass(frozen=True)
class CauseFinder:
    """Finder of the sample, the vehicles and the sub-formula that decide a formula on a recording."""

    formula: Formula
    inputs: Inputs  # (1, T, ...) each
    members: dict[str, tuple[str, ...]]  # vehicles of each group
    body: Floats | None  # as in the result

    def find(self, explanation: Explanation, earliest: bool) -> DecisiveSample:
        """Return the earliest violation, or the sample that decides the robustness."""
        cause = _select_cause(explanation, earliest)
        robustness = cause.chain[0].value if self.body is None else float(self.body[cause.sample])
        consequent = self._explain_consequent(cause, earliest) if robustness <= 0.0 else None
        bindings, leaf = consequent or (cause.bindings, cause.chain[-1])
        vehicles = {variable: str(name) for variable, name in bindings.items()}
        existential = _find_existential(self.formula.node)
        nearest = tuple(variable for variable in vehicles if variable in existential)
        limit = cause.chain[-1].text if consequent is not None else ""
        return DecisiveSample(
            cause.sample,
            robustness,
            vehicles,
            leaf.text,
            leaf.value,
            leaf.sample,
            nearest,
            "" if limit == leaf.text else limit,
        )

    def _explain_consequent(self, cause: Cause, earliest: bool) -> tuple[dict[str, str | int], Link] | None:
        # Why C of ``always (A -> C)`` fails at the sample; None if it does not.
        inner = find_always_body(self.formula.node)
        consequent = None if inner is None else _find_consequent(inner)
        if consequent is None:
            return None
        quantifiers, node = consequent
        chosen = {}
        for quantifier in quantifiers:
            label = cause.bindings.get(quantifier.variable)
            names = self.members.get(quantifier.group, ())
            if label is None:
                return None  # the group is empty
            chosen[quantifier.variable] = str(label), label if isinstance(label, int) else names.index(label)
        bound, inputs = _bind_variables(node, chosen, self.inputs)
        at_sample = dataclasses.replace(
            self.formula, derived=nodes.Window("always", cause.sample, cause.sample, bound)
        )
        explanation = at_sample.explain(inputs, self.members)
        if not explanation.violated:
            return None
        inner_cause = _select_cause(explanation, earliest)
        bindings = {variable: cause.bindings[variable] for variable in chosen} | inner_cause.bindings
        return bindings, inner_cause.chain[-1]


def find_always_body(node: nodes.Node) -> nodes.Node | None:
    """Return φ of ``always φ``; ``forall o in others: always φ`` counts as ``always forall o ...: φ``."""
    match node:
        case nodes.Window(op="always", lo=0, hi=math.inf, child=child):
            return child
        case nodes.Quantifier(op="forall", child=child):
            inner = find_always_body(child)
            return None if inner is None else dataclasses.replace(node, child=inner)
    return None


def is_pointwise(node: nodes.Node) -> bool:
    """Return whether one sample can violate the formula, so that there is a first violation."""
    match node:
        case nodes.Window(op="always"):
            return True
        case nodes.Quantifier(op="forall", child=child):
            return is_pointwise(child)
        case nodes.Connective(op="and", left=left, right=right):
            return is_pointwise(left) and is_pointwise(right)
    return False


def _find_existential(node: nodes.Node, positive: bool = True) -> frozenset[str]:
    # One vehicle is enough for the variables of exists, and for those of forall below a negation.
    match node:
        case nodes.Not(child):
            return _find_existential(child, not positive)
        case nodes.Connective(op="implies", left=left, right=right):
            return _find_existential(left, not positive) | _find_existential(right, positive)
    variables = frozenset[str]()
    if isinstance(node, nodes.Quantifier) and (node.op != "forall") == positive:
        variables = frozenset([node.variable])
    return variables.union(*(_find_existential(child, positive) for child in nodes.children(node)))


def _select_cause(explanation: Explanation, earliest: bool) -> Cause:
    worst = Cause(explanation.worst, explanation.bindings, explanation.chain)
    return explanation.earliest if earliest else worst


def _find_consequent(node: nodes.Node) -> tuple[Sequence[nodes.Quantifier], nodes.Node] | None:
    # C of ``forall o in others: A -> C`` and the quantifiers around it; None for other formulas.
    quantifiers = []
    while isinstance(node, nodes.Quantifier) and node.op == "forall":
        quantifiers.append(node)
        node = node.child
    if not isinstance(node, nodes.Connective) or node.op != "implies":
        return None
    while isinstance(node, nodes.Connective) and node.op == "implies":
        node = node.right
    return quantifiers, node


def _bind_variables(
    node: nodes.Node, chosen: Mapping[str, tuple[str, int]], inputs: Inputs
) -> tuple[nodes.Node, Inputs]:
    # Makes a closed formula of a part of one, with its signals: each quantifier around the part, outermost
    # first, is replaced by the vehicle (name, index) chosen for its variable.
    indices = [index for _, index in chosen.values()]
    names = {variable: name for variable, (name, _) in chosen.items()}
    selected: dict[str, NDArray[Any]] = {}

    def bind_signal(element: nodes.Signal) -> nodes.Signal:
        values = inputs[element.name]
        depths = element.axes if element.arguments else tuple(range(values.ndim - 2))
        for axis in reversed(range(len(depths))):
            if depths[axis] < len(indices):
                single = values.shape[2 + axis] == 1
                values = np.take(values, 0 if single else indices[depths[axis]], axis=2 + axis)
        arguments = tuple(names.get(argument, argument) for argument in element.arguments)
        key = f"{element.name} of {', '.join(arguments)}" if arguments else element.name
        selected[key] = values
        axes = tuple(depth - len(indices) for depth in element.axes if depth >= len(indices))
        return nodes.Signal(key, arguments, axes)

    def bind(element: object) -> Any:
        if isinstance(element, nodes.Signal):
            return bind_signal(element)
        if isinstance(element, tuple):
            return tuple(map(bind, element))
        if not isinstance(element, nodes.Node | nodes.Term):
            return element
        parts = {field.name: bind(getattr(element, field.name)) for field in dataclasses.fields(element)}
        if isinstance(element, nodes.Quantifier):
            parts["depth"] = element.depth - len(indices)
        return type(element)(**parts)

    return bind(node), selected or inputs
