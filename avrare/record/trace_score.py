"""A recorded drive under a specification: robustness over time, and what decided it."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrare.errors import UsageError
from avrare.logic import formula as f
from avrare.logic.api import Formula
from avrare.logic.explain import Link
from avrare.logic.printing import text
from avrare.protocols import Bools, Floats, Specification
from avrare.record.trace import Recording

Inputs = Mapping[str, NDArray[Any]]


@dataclass(frozen=True)
class Moment:
    """What decides a formula at a sample.

    Attributes:
        sample: Index.
        robustness: Of the rule there.
        vehicles: Quantified variable -> the vehicle that decides.
        formula: The sub-formula that decides, with the vehicles' names; empty where nobody can tell.
        value: Its robustness.
    """

    sample: int
    robustness: float
    vehicles: dict[str, str]
    formula: str
    value: float


@dataclass(frozen=True)
class Score:
    """A recording under one specification.

    Attributes:
        name: Of the specification.
        formula: As text, empty where it has none.
        recording: What was scored.
        prefix: (T,) robustness of the samples 0..t.
        violated: (T,) whether the samples 0..t break it.
        body: For ``always φ``: (T,) robustness of φ at each sample; else None.
        first: The earliest violation, None where it is kept.
        worst: Where the robustness is decided, None where nobody can tell.
    """

    name: str
    formula: str
    recording: Recording
    prefix: Floats
    violated: Bools
    body: Floats | None
    first: Moment | None
    worst: Moment | None

    @property
    def robustness(self) -> float:
        """Of the whole trace."""
        return float(self.prefix[-1])

    @property
    def broken(self) -> bool:
        """Whether the whole trace breaks the specification."""
        return bool(self.violated[-1])


def score(name: str, specification: Specification, recording: Recording) -> Score:
    """Follow a specification along a recording.

    Args:
        name: For messages.
        specification: Any; one with a ``formula`` is explained too.
        recording: What it reads.

    Raises:
        UsageError: Signals are missing, or the formula has no value for them.
    """
    prefix, violated = _follow(specification, recording)
    formula: Formula | None = getattr(specification, "formula", None)
    if formula is None:
        broken = int(np.argmax(violated)) if violated[-1] else None
        first = None if broken is None else Moment(broken, float(prefix[broken]), {}, "", math.nan)
        return Score(name, "", recording, prefix, violated, None, first, None)
    inputs = _inputs(specification, recording)
    inner = _body(formula.node)
    body = None if inner is None else dataclasses.replace(formula, node=inner).robustness(inputs)[0]
    members = _members(specification, recording)
    explanation = formula.explain(inputs, members)
    causes = _Causes(formula, inputs, members, body)
    worst = causes.moment(explanation.worst, explanation.bindings, explanation.chain)
    early = explanation.earliest
    first = causes.moment(early.sample, early.bindings, early.chain) if violated[-1] else None
    return Score(name, formula.text, recording, prefix, violated, body, first, worst)


def _follow(specification: Specification, recording: Recording) -> tuple[Floats, Bools]:
    """Robustness and violation of every prefix, (T,) each."""
    prefix, violated = np.zeros(recording.samples), np.zeros(recording.samples, dtype=bool)
    state = specification.start(1)
    for t in range(recording.samples):
        sample = {key: values[t : t + 1] for key, values in recording.signals.items()}
        state, verdict = specification.update(state, sample)
        prefix[t], violated[t] = verdict.robustness[0], verdict.violated[0]
        if math.isnan(prefix[t]):
            text = f"the formula has no value (NaN) at {recording.time(t):g} s"
            raise UsageError(f"{recording.source}: {text}", "look for a difference of infinities, or 0/0")
    return prefix, violated


def _inputs(specification: Specification, recording: Recording) -> Inputs:
    """What the formula reads, (1, T, ...) each: time serves as the batch axis of the predicates."""
    sample = getattr(specification, "sample", None)
    values = recording.signals if sample is None else sample(recording.signals)
    return {key: np.asarray(x)[None] for key, x in values.items()}


def _members(specification: Specification, recording: Recording) -> dict[str, tuple[str, ...]]:
    names = getattr(specification, "names", recording.names)
    return {"others": tuple(names)} if names else {}


def _body(node: f.Node) -> f.Node | None:
    """φ of ``always φ``, also of ``forall o in others: always φ``, which is ``always forall o ...: φ``."""
    match node:
        case f.Window(op="always", lo=0, hi=math.inf, child=child):
            return child
        case f.Quantifier(op="forall", child=child):
            inner = _body(child)
            return None if inner is None else dataclasses.replace(node, child=inner)
    return None


@dataclass(frozen=True)
class _Causes:
    """Turns explanations into moments.

    Attributes:
        formula: The whole.
        inputs: What it reads, (1, T, ...).
        members: group -> vehicles.
        body: Of the score.
    """

    formula: Formula
    inputs: Inputs
    members: dict[str, tuple[str, ...]]
    body: Floats | None

    def moment(self, sample: int, bindings: Mapping[str, str | int], chain: Sequence[Link]) -> Moment:
        """What the rule asks for, if that is simple and fails at the sample; else its weakest part."""
        robustness = chain[0].value if self.body is None else float(self.body[sample])
        words, value = chain[-1].text, chain[-1].value
        vehicles = {variable: str(name) for variable, name in bindings.items()}
        asked = _asked(self.formula.node)
        if self.body is not None and robustness <= 0.0 and isinstance(asked, f.Comparison | f.Predicate):
            found = self._value(asked, sample, vehicles)
            if found <= 0.0:
                words, value = _named(text(asked), vehicles), found
        return Moment(sample, robustness, vehicles, words, value)

    def _value(self, node: f.Node, sample: int, vehicles: Mapping[str, str]) -> float:
        """The robustness of a part, for the vehicles that its quantifiers have chosen."""
        values = self.formula.parts(self.inputs)[text(node)][0, sample]
        names = self.members.get("others", ())
        index = [names.index(name) for name in vehicles.values() if name in names]
        chosen = (k if size > 1 else 0 for k, size in zip(index, values.shape, strict=False))
        return float(values[tuple(chosen)]) if len(index) >= values.ndim else math.inf


def _asked(node: f.Node) -> f.Node:
    """C of ``forall o in others: always (A -> C)``: what the rule asks for when it applies."""
    match node:
        case f.Window(op="always", child=child) | f.Quantifier(op="forall", child=child):
            return _asked(child)
        case f.Connective(op="implies", right=right):
            return _asked(right)
    return node


def _named(words: str, vehicles: Mapping[str, str]) -> str:
    """The text of a formula with the names of vehicles for its variables."""
    return re.sub(r"[^\W\d]\w*", lambda word: vehicles.get(word[0], word[0]), words)
