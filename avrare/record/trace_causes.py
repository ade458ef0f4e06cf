"""What decides a formula on a recorded drive: when, with whom, and by which part."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

from avrare.logic import formula as f
from avrare.logic.api import Formula
from avrare.logic.explain import Cause, Explanation, Link
from avrare.protocols import Floats
from avrare.record.trace_bind import Inputs, bind, consequence


@dataclass(frozen=True)
class Moment:
    """What decides a formula at a sample.

    Attributes:
        sample: Index.
        robustness: Of the rule there.
        vehicles: Quantified variable -> the vehicle that decides.
        formula: The sub-formula that decides, with the vehicles' names; empty where nobody can tell.
        value: Its robustness.
        at: Sample at which the sub-formula has that value: another one where the rule looks ahead or back.
        sought: Those of ``vehicles``' variables for which the rule needs one vehicle and not all: where it is
            broken, theirs is the vehicle that comes nearest.
    """

    sample: int
    robustness: float
    vehicles: dict[str, str]
    formula: str
    value: float
    at: int
    sought: tuple[str, ...] = ()


@dataclass(frozen=True)
class Causes:
    """Turns explanations into moments.

    Attributes:
        formula: The whole.
        inputs: What it reads, (1, T, ...).
        members: group -> vehicles.
        body: For ``always φ``: (T,) robustness of φ at each sample; else None.
    """

    formula: Formula
    inputs: Inputs
    members: dict[str, tuple[str, ...]]
    body: Floats | None

    def first(self, explanation: Explanation) -> Moment:
        """The earliest violation."""
        return self._moment(explanation.earliest, early=True)

    def worst(self, explanation: Explanation) -> Moment:
        """Where the robustness is decided."""
        return self._moment(_worst(explanation), early=False)

    def _moment(self, way: Cause, early: bool) -> Moment:
        """What the rule asks for where that fails at the sample, else its weakest part."""
        robustness = way.chain[0].value if self.body is None else float(self.body[way.sample])
        asked = self._asked(way, early) if robustness <= 0.0 else None
        bindings, leaf = asked or (way.bindings, way.chain[-1])
        vehicles = {variable: str(name) for variable, name in bindings.items()}
        needed = sought(self.formula.node)
        one = tuple(variable for variable in vehicles if variable in needed)
        return Moment(way.sample, robustness, vehicles, leaf.text, leaf.value, leaf.sample, one)

    def _asked(self, way: Cause, early: bool) -> tuple[dict[str, str | int], Link] | None:
        """Why C of ``always (A -> C)`` fails at the sample; None for other rules, or where it holds."""
        inner = body(self.formula.node)
        found = None if inner is None else consequence(inner)
        if found is None:
            return None
        outer, node = found
        chosen = {}
        for quantifier in outer:
            label = way.bindings.get(quantifier.variable)
            names = self.members.get(quantifier.group, ())
            if label is None:
                return None  # the group is empty
            chosen[quantifier.variable] = str(label), label if isinstance(label, int) else names.index(label)
        part = bind(node, chosen, self.inputs)
        there = dataclasses.replace(self.formula, node=f.Window("always", way.sample, way.sample, part.node))
        explanation = there.explain(part.inputs, self.members)
        cause = explanation.earliest if early else _worst(explanation)
        bindings = {variable: way.bindings[variable] for variable in chosen} | cause.bindings
        return (bindings, cause.chain[-1]) if explanation.violated else None


def _worst(explanation: Explanation) -> Cause:
    return Cause(explanation.worst, explanation.bindings, explanation.chain)


def body(node: f.Node) -> f.Node | None:
    """φ of ``always φ``, also of ``forall o in others: always φ``, which is ``always forall o ...: φ``."""
    match node:
        case f.Window(op="always", lo=0, hi=math.inf, child=child):
            return child
        case f.Quantifier(op="forall", child=child):
            inner = body(child)
            return None if inner is None else dataclasses.replace(node, child=inner)
    return None


def pointwise(node: f.Node) -> bool:
    """Whether one sample alone can break the formula, so that it makes sense to ask for the first one."""
    match node:
        case f.Window(op="always"):
            return True
        case f.Quantifier(op="forall", child=child):
            return pointwise(child)
        case f.Connective(op="and", left=left, right=right):
            return pointwise(left) and pointwise(right)
    return False


def sought(node: f.Node, positive: bool = True) -> frozenset[str]:
    """The variables for which a formula needs one vehicle: of exists, and of forall below a negation."""
    match node:
        case f.Not(child):
            return sought(child, not positive)
        case f.Connective(op="implies", left=left, right=right):
            return sought(left, not positive) | sought(right, positive)
    one = isinstance(node, f.Quantifier) and (node.op != "forall") == positive
    own = frozenset([node.variable]) if isinstance(node, f.Quantifier) and one else frozenset[str]()
    return own.union(*(sought(child, positive) for child in f.children(node)))
