"""A recorded drive under a specification: robustness over time, and what decided it."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np

from avrare.errors import UsageError
from avrare.logic import formula as f
from avrare.logic.api import Formula
from avrare.protocols import Bools, Floats, Specification
from avrare.record.trace import Recording
from avrare.record.trace_bind import Inputs
from avrare.record.trace_causes import Causes, Moment, body, pointwise


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
        first: The earliest violation; None where it is kept, or where no sample alone can break it.
        worst: Where the robustness is decided, None where nobody can tell.
        pointwise: One sample alone can break it, as with ``always``; ``worst`` then is its least moment.
        nobody: It speaks of vehicles, but of none in this recording.
        excluded: Vehicles of the recording that the specification leaves out.
    """

    name: str
    formula: str
    recording: Recording
    prefix: Floats
    violated: Bools
    body: Floats | None
    first: Moment | None
    worst: Moment | None
    pointwise: bool = True
    nobody: bool = False
    excluded: tuple[str, ...] = ()

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
        first = None if broken is None else Moment(broken, float(prefix[broken]), {}, "", math.nan, broken)
        return Score(name, "", recording, prefix, violated, None, first, None)
    inputs = _inputs(specification, recording)
    inner = body(formula.node)
    values = None if inner is None else dataclasses.replace(formula, node=inner).robustness(inputs)[0]
    members = _members(specification, recording)
    explanation = formula.explain(inputs, members)
    causes = Causes(formula, inputs, members, values)
    timely = pointwise(formula.node)
    first = causes.first(explanation) if violated[-1] and timely else None
    nobody = not members and any(isinstance(part, f.Quantifier) for part in f.walk(formula.node))
    return Score(
        name, formula.text, recording, prefix, violated, values, first, causes.worst(explanation),
        pointwise=timely, nobody=nobody, excluded=tuple(getattr(specification, "excluded", ())),
    )  # fmt: skip


def _follow(specification: Specification, recording: Recording) -> tuple[Floats, Bools]:
    """Robustness and violation of every prefix, (T,) each."""
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


def _inputs(specification: Specification, recording: Recording) -> Inputs:
    """What the formula reads, (1, T, ...) each: time serves as the batch axis of the predicates."""
    sample = getattr(specification, "sample", None)
    values = recording.signals if sample is None else sample(recording.signals)
    return {key: np.asarray(x)[None] for key, x in values.items()}


def _members(specification: Specification, recording: Recording) -> dict[str, tuple[str, ...]]:
    names = getattr(specification, "names", recording.names)
    return {"others": tuple(names)} if names else {}
