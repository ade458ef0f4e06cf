"""Problem: a system, its specifications and the number of steps."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from fractions import Fraction
from functools import cached_property, partial

import numpy as np

from avrare.base.errors import UsageError, did_you_mean
from avrare.driving import Scene
from avrare.logic.formula import Formula, FormulaMonitor
from avrare.protocols import Floats, Specification, System, adapt, overrides
from avrare.rollout.child_process import run_guarded, run_here
from avrare.rollout.engine import simulate
from avrare.rollout.noise import NoiseSource
from avrare.rollout.request import Request, Rollouts, choose_chunk
from avrare.rollout.scores.progress_score import ProgressScored, shape_of
from avrare.rollout.scores.scored_specifications import (
    Deciding,
    FormulaScored,
    FunctionScored,
    MarginScored,
    PrefixScored,
    ScoreFunction,
)
from avrare.rollout.scores.term_sizes import (
    ScaledMonitor,
    Select,
    Sizes,
    find_flat_parts,
    measure_terms,
    record,
)
from avrare.rollout.twin import Twin, check_twin
from avrare.stack.part_checks import check_dynamics

_MEASURING = "the rollouts that measure the terms of its score"
SCORES = ("robustness", "margin", "progress")


class Problem:
    """System with one specification (or several that are monitored in one pass).

    Args:
        system: An ``avrare.protocols.System``, such as the closed loop of a scenario, or an object of any
            class with ``noise_size``, ``initial``, ``step`` and ``signals``.
        specification: A formula from ``avrare.stl``, any ``Specification``, or a mapping of names to them.
        steps: Last step: states t = 0..steps are simulated; 0 is a static problem.
        score: Importance score for splitting: ``function(signals so far, t) -> (N,)``, a formula whose own
            running score orders the particles in place of the specification's, or a name:
            "robustness" (the formula's own), "margin" (see ``MarginScored``; where the noise-free rollout
            has no margin, as "robustness"), "progress" (see ``progress_score``). By default "progress"
            for formulas that may still become true, such as ``eventually``, else "robustness". All but a
            function and "robustness" by name measure each term of the formula that orders the particles in
            its own size (see ``measure_terms``). The rollouts that this and "margin" and "progress" need,
            one or two without noise and at most 64 others, run once in each process, before the first that
            is scored; no cost counts them.
        chunk: Rollouts per unit of work; changes no result of a system whose rows are independent. By
            default chosen from the memory of a row and the steps (``avrare.rollout.request``).
        rollout_timeout: Seconds that a single rollout may take, else it is an error. All rollouts then run
            in worker processes, one too, so that one that ends its process is an error as well.

    Raises:
        UsageError: An argument does not fit.
    """

    def __init__(
        self,
        system: object,
        specification: Formula | Specification | Mapping[str, Formula | Specification],
        steps: int,
        score: ScoreFunction | Formula | str | None = None,
        *,
        chunk: int | None = None,
        rollout_timeout: float | None = None,
    ) -> None:
        _check_integer("steps", steps, 0)
        if rollout_timeout is not None and not 0.0 < rollout_timeout < math.inf:
            raise UsageError(f"rollout_timeout must be a positive number of seconds, not {rollout_timeout!r}")
        if chunk is not None:
            _check_integer("chunk", chunk, 1)
        self.system = adapt(System, system)
        _check_integer(f"{type(system).__name__}.noise_size", self.system.noise_size, 0)
        check_dynamics(self.system)
        _check_step(type(system).__name__, self.system.dt)
        self.system.check_steps(steps)
        if not (score is None or isinstance(score, Formula) or callable(score) or score in SCORES):
            raise UsageError(f"unknown score {score!r}", did_you_mean(str(score), SCORES))
        self.steps = int(steps)
        self.score = score.at(self.dt) if isinstance(score, Formula) and self.dt is not None else score
        self.named_chunk = None if chunk is None else int(chunk)
        self.rollout_timeout = rollout_timeout
        specifications = (
            specification if isinstance(specification, Mapping) else {"specification": specification}
        )
        if not specifications:
            raise UsageError("a problem needs at least one specification")
        self.names = tuple(specifications)
        self.monitors: tuple[Specification, ...] = tuple(
            _as_monitor(spec, self.dt) for spec in specifications.values()
        )
        self._scored: tuple[Specification, ...] | None = None
        self._sizes: tuple[Sizes | None, ...] | None = None
        self._twin: Twin | None = None

    @cached_property
    def chunk(self) -> int:
        """Largest number of rollouts per unit of work."""
        return self.named_chunk or run_guarded(
            "its noise-free start", self.system, partial(choose_chunk, self.system, self.monitors, self.steps)
        )

    @property
    def noise_size(self) -> int:
        """Number of standard normal numbers per step and particle."""
        return int(self.system.noise_size)

    @property
    def dt(self) -> float | None:
        """Time of a step [s], None where the system has none."""
        return None if self.system.dt is None else float(self.system.dt)

    @property
    def scene(self) -> Scene | None:
        """Road, sizes and names of a driving simulator, else None."""
        return self.system.scene

    def monitor(self, name: str) -> Specification:
        """Return the monitor of a specification."""
        return self.monitors[self.names.index(name)]

    @property
    def specifications(self) -> tuple[Specification, ...]:
        """Monitors with the chosen score."""
        if self._scored is None:
            self._scored = self._with_score()
        return self._scored

    @property
    def sizes(self) -> tuple[Sizes | None, ...]:
        """Sizes of the terms of each specification's formula, or of that which orders in its place.

        None where the unscaled formula orders alike.
        """
        if self._sizes is None:
            self._sizes = run_guarded(_MEASURING, self.system, self._measure_sizes)
        return self._sizes

    @property
    def twin(self) -> Twin | None:
        """Cheap stand-in on the same tapes; None where there is none."""
        return self._twin

    def with_twin(self, twin: Problem, cost: float | None = None) -> Problem:
        """Return the same problem with a cheap twin, for estimator "mfmc".

        Args:
            twin: Problem with specifications of the same names, that reads the same noise tapes.
            cost: Time of a rollout of the twin over that of this problem; `mfmc` needs it.

        Raises:
            UsageError: Their tapes have different shapes, or a specification is missing.
        """
        check_twin(self, twin, cost)
        other = object.__new__(type(self))
        other.__dict__.update(self.__dict__)
        other._twin = Twin(twin, cost)
        return other

    def flat_parts(self, index: int, failures: Floats | None = None) -> tuple[str, ...]:
        """Return the parts of a specification's formula whose failures no score by it leads to.

        Those that known failures break, given by their tapes, are none of them.
        """
        guide_formula = None if callable(self.score) else self._find_guide(self.monitors[index])
        if guide_formula is None:
            return ()
        measure = self._measure(index)
        guide = measure if isinstance(measure, ScaledMonitor) else None
        by_sample = isinstance(measure, MarginScored | ProgressScored)
        return find_flat_parts(
            self.system, self.steps, *guide_formula, guide, by_sample=by_sample, failures=failures
        )

    def rescore(self, score: ScoreFunction | Formula | str) -> Problem:
        """Return the same problem with another score; ``"prefix"`` stands for ``PrefixScored``."""
        other = object.__new__(type(self))  # copy.copy would call __reduce__, which calls this method
        other.__dict__.update(self.__dict__)
        other.score, other._scored = score, None
        if isinstance(score, Formula) or isinstance(self.score, Formula):
            other._sizes = None
        return other

    def separate(self) -> list[Problem]:
        """Return a problem for each specification; the only one of a problem is the problem itself."""
        return [self.subset([name]) for name in self.names]

    def subset(self, names: Sequence[str]) -> Problem:
        """Return the problem of some specifications; of all of them it is the problem itself."""
        if tuple(names) == self.names:
            return self
        rows = [self.names.index(name) for name in names]
        part = object.__new__(type(self))
        part.__dict__.update(self.__dict__)
        part.names, part.monitors = tuple(names), tuple(self.monitors[row] for row in rows)
        part._scored, part._sizes = None, self._sizes and tuple(self._sizes[row] for row in rows)
        return part

    def gamma(self, level: float) -> float:
        """Return the robustness threshold of a score's level, 0 at failure as in the papers."""
        return 1.0 - level if isinstance(self._measure(0), MarginScored | ProgressScored) else -level

    def simulate(self, noise: NoiseSource, request: Request, *, scored: bool = True) -> Rollouts:
        """Run a request; ``scored=False`` skips the importance score."""
        run_here(self.system)
        specifications = self.specifications if scored else self.monitors
        if request.stop_early or request.stop_failed:
            pairs = zip(specifications, self.monitors, strict=True)
            specifications = tuple(Deciding(spec, self.steps + 1, judge) for spec, judge in pairs)
        return simulate(self.system, specifications, self.steps, noise, request, scored=scored)

    def replay(self, tape: Floats, *, keep_carries: bool = False) -> Rollouts:
        """Run given noise (N, steps + 1, noise_size)."""
        tape = read_tape(tape)
        expected = (self.steps + 1, self.noise_size)
        if tape.ndim != 3 or tape.shape[1:] != expected:
            raise UsageError(
                f"noise has shape {tape.shape}, but this problem needs (N, {expected[0]}, {expected[1]})"
            )
        request = Request.replay(tape, keep_carries=keep_carries)
        return self.simulate(NoiseSource(0, self.noise_size), request, scored=False)

    def robustness(self, noise: Floats) -> Floats:
        """Return robustness (N,) of the first specification on noise (N, steps + 1, noise_size).

        It is NaN where the rollout breaks down.
        """
        outcome = self.replay(noise)
        return np.where(outcome.error, np.nan, outcome.robustness[:, 0])

    def nominal(self, *, keep_carries: bool = False) -> Rollouts:
        """Run the noise-free rollout, one row."""
        return self.replay(np.zeros((1, self.steps + 1, self.noise_size)), keep_carries=keep_carries)

    def _measure_sizes(self) -> tuple[Sizes | None, ...]:
        return tuple(
            measure_terms(self.system, self.steps, *guide) if guide else None
            for guide in map(self._find_guide, self.monitors)
        )

    def _measure(self, index: int) -> Specification:
        spec = self.specifications[index]
        return spec.guide if isinstance(spec, FormulaScored) else spec

    def _with_score(self) -> tuple[Specification, ...]:
        if isinstance(self.score, Formula):
            guide = self._guide(0) or FormulaMonitor(self.score)
            return tuple(FormulaScored(spec, guide) for spec in self.monitors)
        if callable(self.score):
            return tuple(FunctionScored(spec, self.score) for spec in self.monitors)
        match self.score:
            case "margin":
                return self._with_margin()
            case "progress":
                return self._with_progress()
            case "prefix":
                return tuple(PrefixScored(spec) for spec in self.monitors)
            case "robustness":
                return self.monitors
        return tuple(
            self._score_by_progress(k) or self._score_by_terms(k) or spec
            for k, spec in enumerate(self.monitors)
        )

    def _with_progress(self) -> tuple[Specification, ...]:
        scored = [self._score_by_progress(k) for k in range(len(self.monitors))]
        for name, spec in zip(self.names, scored, strict=True):
            if spec is None:
                raise UsageError(
                    f"score 'progress' does not fit {name}",
                    "it needs a formula that looks ahead in another way than `always ...` and has no "
                    "quantifier, iff, xor or negated until over such parts; leave the score out",
                )
        return tuple(spec for spec in scored if spec is not None)

    def _score_by_progress(self, index: int) -> Specification | None:
        spec = self.monitors[index]
        if not isinstance(spec, FormulaMonitor) or shape_of(spec.formula) is None:
            return None
        guide = self._guide(index)
        shape = shape_of((guide or spec).formula)
        assert shape is not None  # that of the formula: only its terms differ
        tape = np.zeros((1, self.steps + 1, self.noise_size))
        replay = partial(record, self.system, self.steps, spec.formula.signals, Request.replay(tape))
        trace = run_guarded(_MEASURING, self.system, replay) or {}
        nominal = (
            [{name: x[:, t] for name, x in trace.items()} for t in range(self.steps + 1)] if trace else None
        )
        return ProgressScored(spec, shape, self.steps, nominal, guide)

    def _score_by_terms(self, index: int) -> Specification | None:
        guide = self._guide(index)
        return FormulaScored(self.monitors[index], guide) if guide else None

    def _guide(self, index: int) -> ScaledMonitor | None:
        sizes = self.sizes[index]
        if sizes is None:
            return None
        guide = self._find_guide(self.monitors[index])
        assert guide is not None  # the sizes are its terms'
        formula, select = guide
        return ScaledMonitor(formula, sizes, select)

    def _find_guide(self, spec: Specification) -> tuple[Formula, Select | None] | None:
        # The formula that orders the particles, and what makes its signals.
        if isinstance(self.score, Formula):
            return self.score, None
        if isinstance(spec, FormulaMonitor):
            return spec.formula, None
        selects = overrides(spec, Specification.sample) and isinstance(spec.formula, Formula)
        return (spec.formula, spec.sample) if selects else None

    def _with_margin(self) -> tuple[Specification, ...]:
        guides = [self._guide(index) for index in range(len(self.monitors))]
        judges = tuple(guide or spec for guide, spec in zip(guides, self.monitors, strict=True))
        margins = run_guarded(_MEASURING, self.system, partial(self._nominal_margins, judges))
        scored: list[Specification] = []
        rows = zip(self.names, self.monitors, guides, judges, margins, strict=True)
        for name, spec, guide, judge, along in rows:
            if any(value is None for value in along):
                raise UsageError(
                    f"score 'margin' does not fit {name}",
                    "it needs a formula of the shape `always ...`; leave the score out, or give a function",
                )
            nominal = np.array(along)
            # Without a positive margin along the complete noise-free rollout, robustness is the score.
            lost = len(nominal) <= self.steps or nominal.min() <= 0
            measure = judge if lost else MarginScored(judge, nominal)
            scored.append(FormulaScored(spec, measure) if guide else measure)
        return tuple(scored)

    def _nominal_margins(self, judges: tuple[Specification, ...]) -> list[list[float | None]]:
        """Return the margins of all specifications along the noise-free rollout, None where one has none."""
        tape = np.zeros((1, self.steps + 1, self.noise_size))
        request, noise = Request.replay(tape, keep_carries=True), NoiseSource(0, self.noise_size)
        outcome = simulate(self.system, judges, self.steps, noise, request, scored=False)
        states = [carry.monitors for *_, carry in outcome.carries]
        return [
            [_margin_of(judge, monitors[index]) for monitors in states] for index, judge in enumerate(judges)
        ]


def read_tape(noise: object) -> Floats:
    """Return noise as an array of numbers, of whatever shape.

    Raises:
        UsageError: It is none, or holds NaN.
    """
    hint = "give tapes such as result.failures.noise"
    try:
        numbers = np.asarray(noise, dtype=np.float64)
    except (TypeError, ValueError):
        raise UsageError(f"the noise is not an array of numbers, but {type(noise).__name__}", hint) from None
    if np.isnan(numbers).any():
        raise UsageError("the noise holds NaN", hint)
    return numbers


def _margin_of(judge: Specification, state: object) -> float | None:
    margin = judge.margin(state)
    return None if margin is None else float(margin[0])


def _check_integer(name: str, value: object, least: int) -> None:
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < least:
        raise UsageError(f"{name} must be an integer of at least {least}, not {value!r}")


def _check_step(name: str, dt: object) -> None:
    if dt is None:
        return
    if isinstance(dt, (int, float, Fraction, np.number)) and not isinstance(dt, bool) and 0 < dt < math.inf:
        return
    hint = "give the time of a step in seconds, or leave dt out"
    raise UsageError(f"{name}.dt must be a positive number, not {dt!r}", hint)


def _as_monitor(specification: Formula | Specification, dt: float | None) -> Specification:
    formula = specification.formula if isinstance(specification, FormulaMonitor) else specification
    if isinstance(formula, Formula):
        return FormulaMonitor(formula if dt is None else formula.at(dt))
    if not (hasattr(specification, "start") and hasattr(specification, "update")):
        raise UsageError(
            f"{specification!r} is not a specification",
            'write avrare.stl("always (x < 4)") or give an object with start and update',
        )
    return adapt(Specification, specification)
