"""Monitoring of a recorded drive under a specification: robustness over time, and its causes."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrare.analysis.monitor.long_recordings import Stretches
from avrare.base.errors import UsageError
from avrare.logic.explanation import Cause, Explanation, Link
from avrare.logic.formula import Formula, find_formula
from avrare.logic.syntax import nodes
from avrare.protocols import (
    Bools,
    ExcludesVehicles,
    Floats,
    NamesVehicles,
    SelectsSamples,
    Specification,
    find_ability,
)
from avrare.results.recordings.recording import Recording

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
class MonitoringResult:
    """A recording under one specification."""

    name: str
    formula: str  # text; empty if the specification has none
    recording: Recording
    prefix: Floats  # (T,) robustness of samples 0..t
    prefix_violated: Bools  # (T,) samples 0..t violate the specification
    body: Floats | None  # (T,) for ``always φ``: robustness of φ at each sample
    first: DecisiveSample | None  # earliest violation; None without one, or if no single sample can violate
    worst: DecisiveSample | None  # decides the robustness; None if unknown
    pointwise: bool = True  # one sample can violate, as with ``always``: ``worst`` is the least robust
    no_vehicles: bool = False  # it quantifies over vehicles, and the recording has none of them
    excluded: tuple[str, ...] = ()  # vehicles of the recording that it ignores

    @property
    def robustness(self) -> float:
        """Robustness of the complete recording."""
        return float(self.prefix[-1])

    @property
    def violated(self) -> bool:
        """Verdict on the complete recording."""
        return bool(self.prefix_violated[-1])


def monitor_recording(name: str, specification: Specification, recording: Recording) -> MonitoringResult:
    """Run the monitor of a specification along a recording; one with a formula is also explained.

    UsageError if signals are missing, or if the formula has no value for them.
    """
    prefix, violated = _run_monitor(specification, recording)
    formula = find_formula(specification)
    if formula is None:
        first = None
        if violated[-1]:
            sample = int(np.argmax(violated))
            first = DecisiveSample(sample, float(prefix[sample]), {}, "", math.nan, sample)
        return MonitoringResult(name, "", recording, prefix, violated, None, first, None)
    names = list_vehicle_names(specification, recording)
    members = {"others": names} if names else {}
    body, first, worst = _find_causes(specification, recording, formula, members, bool(violated[-1]))
    pointwise = _is_pointwise(formula.node)
    quantified = any(isinstance(part, nodes.Quantifier) for part in nodes.walk(formula.node))
    excluding = find_ability(specification, ExcludesVehicles)
    return MonitoringResult(
        name,
        formula.text,
        recording,
        prefix,
        violated,
        body,
        first=first if pointwise else None,
        worst=worst,
        pointwise=pointwise,
        no_vehicles=not names and quantified,
        excluded=() if excluding is None else tuple(excluding.excluded),
    )


def _find_causes(
    specification: Specification,
    recording: Recording,
    formula: Formula,
    members: dict[str, tuple[str, ...]],
    violated: bool,
) -> tuple[Floats | None, DecisiveSample | None, DecisiveSample | None]:
    # The body of an ``always`` formula, the earliest violation, and the sample that decides.
    inner = _find_always_body(formula.node)
    stretches = _make_stretches(specification, recording, formula)
    if stretches is None or stretches.fits:
        inputs = select_inputs(specification, recording)
        body = None if inner is None else dataclasses.replace(formula, node=inner).robustness(inputs)[0]
        explanation = formula.explain(inputs, members)
        causes = _CauseFinder(formula, inputs, members, body)
        first = causes.find(explanation, earliest=True) if violated else None
        return body, first, causes.find(explanation, earliest=False)
    body, _, first, worst = _explain_stretches(stretches, members)
    return body, first if violated else None, worst


Body = tuple[Floats, Bools, DecisiveSample | None, DecisiveSample]
"""Robustness and truth of an ``always`` formula's body, its first violation and its decisive sample."""


def describe_body(specification: Specification, recording: Recording) -> Body | None:
    """Evaluate the body of an ``always`` formula on a recording, without its value over time.

    None if the specification is no such formula, or the body reads the whole recording.
    """
    formula = find_formula(specification)
    stretches = None if formula is None else _make_stretches(specification, recording, formula)
    if stretches is None or stretches.is_unbounded or not _is_pointwise(stretches.formula.node):
        return None
    names = list_vehicle_names(specification, recording)
    return _explain_stretches(stretches, {"others": names} if names else {})


def _make_stretches(specification: Specification, recording: Recording, formula: Formula) -> Stretches | None:
    def read(first: int, end: int) -> Inputs:
        return select_inputs(specification, recording, slice(first, end))

    inner = _find_always_body(formula.node)
    if inner is None:
        return None
    return Stretches(formula, inner, read, recording.samples, len(recording.names))


def _explain_stretches(stretches: Stretches, members: dict[str, tuple[str, ...]]) -> Body:
    body, truth = stretches.evaluate()

    def explain(sample: int, earliest: bool) -> DecisiveSample:
        begin, inputs, explanation = stretches.explain(sample, members)
        causes = _CauseFinder(stretches.formula, inputs, members, body[begin:])
        found = causes.find(explanation, earliest)
        at = {name: getattr(found, name) + begin for name in ("sample", "formula_sample")}
        return dataclasses.replace(found, **at)

    first = None if truth.all() else explain(int(np.argmin(truth)), True)
    return body, truth, first, explain(int(np.argmin(body)), False)


def select_inputs(specification: Specification, recording: Recording, span: slice = slice(None)) -> Inputs:
    """Return the signals of the specification's formula, (1, T, ...) each, at the samples of a span."""
    # Predicates take batches of one sample: time serves as their batch axis.
    signals = {key: values[span] for key, values in recording.signals.items()}
    selecting = find_ability(specification, SelectsSamples)
    values = signals if selecting is None else selecting.sample(signals)
    return {key: np.asarray(x)[None] for key, x in values.items()}


def list_vehicle_names(specification: Specification, recording: Recording) -> tuple[str, ...]:
    """Return the names of the vehicles that the specification's quantifiers range over."""
    naming = find_ability(specification, NamesVehicles)
    return tuple(recording.names if naming is None else naming.names)


def _run_monitor(specification: Specification, recording: Recording) -> tuple[Floats, Bools]:
    prefix, violated = np.zeros(recording.samples), np.zeros(recording.samples, dtype=bool)
    state = specification.start(1)
    for t in range(recording.samples):
        sample = {key: values[t : t + 1] for key, values in recording.signals.items()}
        state, verdict = specification.update(state, sample)
        prefix[t], violated[t] = verdict.robustness[0], verdict.violated[0]
        if math.isnan(prefix[t]):
            message = f"the formula has no value (NaN) at {recording.time(t):g} s"
            raise UsageError(f"{recording.source}: {message}", "look for a difference of infinities, or 0/0")
    return prefix, violated


@dataclass(frozen=True)
class _CauseFinder:
    formula: Formula
    inputs: Inputs  # (1, T, ...) each
    members: dict[str, tuple[str, ...]]  # vehicles of each group
    body: Floats | None  # as in the result

    def find(self, explanation: Explanation, earliest: bool) -> DecisiveSample:
        # The earliest violation, or the sample that decides the robustness.
        cause = _select_cause(explanation, earliest)
        robustness = cause.chain[0].value if self.body is None else float(self.body[cause.sample])
        consequent = self._explain_consequent(cause, earliest) if robustness <= 0.0 else None
        bindings, leaf = consequent or (cause.bindings, cause.chain[-1])
        vehicles = {variable: str(name) for variable, name in bindings.items()}
        existential = _find_existential(self.formula.node)
        nearest = tuple(variable for variable in vehicles if variable in existential)
        limit = cause.chain[-1].text if consequent is not None else ""
        return DecisiveSample(
            cause.sample, robustness, vehicles, leaf.text, leaf.value, leaf.sample, nearest,
            "" if limit == leaf.text else limit,
        )  # fmt: skip

    def _explain_consequent(self, cause: Cause, earliest: bool) -> tuple[dict[str, str | int], Link] | None:
        # Why C of ``always (A -> C)`` fails at the sample; None if it does not.
        inner = _find_always_body(self.formula.node)
        found = None if inner is None else _find_consequent(inner)
        if found is None:
            return None
        quantifiers, node = found
        chosen = {}
        for quantifier in quantifiers:
            label = cause.bindings.get(quantifier.variable)
            names = self.members.get(quantifier.group, ())
            if label is None:
                return None  # the group is empty
            chosen[quantifier.variable] = str(label), label if isinstance(label, int) else names.index(label)
        bound, inputs = _bind_variables(node, chosen, self.inputs)
        at_sample = dataclasses.replace(
            self.formula, node=nodes.Window("always", cause.sample, cause.sample, bound)
        )
        explanation = at_sample.explain(inputs, self.members)
        if not explanation.violated:
            return None
        inner_cause = _select_cause(explanation, earliest)
        bindings = {variable: cause.bindings[variable] for variable in chosen} | inner_cause.bindings
        return bindings, inner_cause.chain[-1]


def _find_always_body(node: nodes.Node) -> nodes.Node | None:
    # φ of ``always φ``; ``forall o in others: always φ`` counts as ``always forall o ...: φ``
    match node:
        case nodes.Window(op="always", lo=0, hi=math.inf, child=child):
            return child
        case nodes.Quantifier(op="forall", child=child):
            inner = _find_always_body(child)
            return None if inner is None else dataclasses.replace(node, child=inner)
    return None


def _is_pointwise(node: nodes.Node) -> bool:
    # One sample can violate the formula, so that there is a first violation.
    match node:
        case nodes.Window(op="always"):
            return True
        case nodes.Quantifier(op="forall", child=child):
            return _is_pointwise(child)
        case nodes.Connective(op="and", left=left, right=right):
            return _is_pointwise(left) and _is_pointwise(right)
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

    def bind_signal(item: nodes.Signal) -> nodes.Signal:
        values = inputs[item.name]
        depths = item.axes if item.arguments else tuple(range(values.ndim - 2))
        for axis in reversed(range(len(depths))):
            if depths[axis] < len(indices):
                single = values.shape[2 + axis] == 1
                values = np.take(values, 0 if single else indices[depths[axis]], axis=2 + axis)
        arguments = tuple(names.get(argument, argument) for argument in item.arguments)
        key = f"{item.name} of {', '.join(arguments)}" if arguments else item.name
        selected[key] = values
        axes = tuple(depth - len(indices) for depth in item.axes if depth >= len(indices))
        return nodes.Signal(key, arguments, axes)

    def bind(item: Any) -> Any:
        if isinstance(item, nodes.Signal):
            return bind_signal(item)
        if isinstance(item, tuple):
            return tuple(map(bind, item))
        if not isinstance(item, nodes.Node | nodes.Term):
            return item
        parts = {field.name: bind(getattr(item, field.name)) for field in dataclasses.fields(item)}
        if isinstance(item, nodes.Quantifier):
            parts["depth"] = item.depth - len(indices)
        return type(item)(**parts)

    return bind(node), selected or inputs
