"""Rollout engine: advances a batch of particles through time, from the start or from stored carries.

All active rows are at the same step t; a row that starts at step s joins when t reaches s. A row that breaks
down leaves the batch, keeps its score, and is reported as an error: never as a pass or a failure.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np

from avrare.base import batch
from avrare.base.errors import FIRST_ROLLOUTS, AvrareError, EveryRolloutBroke, UsageError
from avrare.protocols import Bools, Floats, Signals, Specification, System, adapt
from avrare.rollout.noise import NoiseSource
from avrare.rollout.request import FROM_START, Carry, Integers, Request, Rollouts
from avrare.rollout.tape_source import TapeDrawer, draw_lineage
from avrare.stack.features import monitor_features, system_features
from avrare.stack.part_checks import check_rows, check_signals, find_nan

_AnswerT = TypeVar("_AnswerT")
Sample = tuple[Any, Signals, Bools]
"""State, signals (N, ...) and a mask (N,) of rows that have broken down."""


def simulate(
    system: System,
    specifications: tuple[Specification, ...],
    steps: int,
    noise: NoiseSource,
    request: Request,
    *,
    scored: bool = True,
) -> Rollouts:
    """Run the rows of ``request`` to ``steps`` or their breakdown; the first specification scores."""
    if request.law is not None:
        system = adapt(System, system.under(request.law))
    if request.past is not None:
        request = _restore_carries(system, specifications, noise, request)
    drawer = TapeDrawer(noise, request, steps)
    return _Simulation(system, specifications, steps, drawer, request, scored).run()


class _CarryStore:
    """Carries to return: every k-th step, where k doubles once they take too much memory.

    Of a segment only that of its last step is wanted. k depends only on the bytes of a row, so it is the same
    for every chunk.
    """

    def __init__(self, request: Request, steps: int) -> None:
        self.every, self.most_bytes, self.steps = request.every, request.most_bytes, steps
        self.only_last = request.until is not None
        self.carries: list[tuple[int, Integers, Carry]] = []
        self._row_bytes: dict[int, int] = {}

    def add(self, t: int, rows: Integers, carry: Carry) -> None:
        if not self._is_wanted(t):
            return
        self.carries.append((t, rows, carry))
        if not self.most_bytes:
            return
        self._row_bytes[t] = sum(leaf.nbytes for leaf in batch.leaves(carry)) // len(rows)
        while self.most_bytes < sum(self._row_bytes.values()) and self.every <= t:
            self.every *= 2
            self.carries = [entry for entry in self.carries if self._is_wanted(entry[0])]
            self._row_bytes = {step: size for step, size in self._row_bytes.items() if self._is_wanted(step)}

    def _is_wanted(self, t: int) -> bool:
        return (t % self.every == 0 and not self.only_last) or t == self.steps


class _Simulation:
    def __init__(
        self,
        system: System,
        specifications: tuple[Specification, ...],
        steps: int,
        noise: TapeDrawer,
        request: Request,
        scored: bool,
    ) -> None:
        self.system, self.specifications, self.steps = system, specifications, steps
        self.noise, self.request, self.scored = noise, request, scored
        self.raised, rows, count = 0, request.rows, len(specifications)  # rows that raise, in succession
        self.robustness = np.full((rows, count), np.inf)
        self.violated = np.zeros((rows, count), dtype=bool)
        self.error = np.zeros(rows, dtype=bool)
        self.scores = np.full((rows, steps + 1 if scored else 0), -np.inf)
        self.log_weight = np.zeros(rows)
        self.simulated_steps = int(request.past.paid.sum()) if request.past is not None else 0
        self.counts: dict[str, Integers] = {}
        self.messages: dict[str, int] = {}  # each with the first row that it is of
        self.last = steps if request.until is None else min(request.until, steps)
        self.store = _CarryStore(request, self.last)
        self.features: dict[int, tuple[Integers, Floats]] = {}

    def run(self) -> Rollouts:
        carries, start = dict(self.request.carries), self.request.start
        first = int(start[0]) if len(start) else self.last
        carry: Carry | None = None
        rows = np.zeros(0, dtype=np.int64)
        for t in range(max(first, 0), self.last + 1):
            if carry is not None:
                carry, rows = self._advance(carry, rows, t)
            if t == 0 and first == FROM_START:
                carry, rows = self._begin(np.flatnonzero(start == FROM_START))
            if t in carries:
                carry, rows = self._join(carry, rows, carries[t], np.flatnonzero(start == t), t)
            keeps_carries = self.request.keep_carries
            if (
                keeps_carries and carry is not None and self.request.stop_early
            ):  # others may branch where a row ends
                self.store.add(t, rows, carry)
            if carry is not None:
                carry, rows = self._leave(carry, rows, t)
            if keeps_carries and carry is not None and not self.request.stop_early:
                self.store.add(t, rows, carry)
            if carry is not None and t in self.request.observe:
                self.features[t] = rows, self._features(carry)
        if carry is not None:
            self._finish(carry, rows, final=self.last == self.steps)
        for values in self.counts.values():
            values[self.error] = 0
        return Rollouts(
            self.robustness,
            self.violated,
            self.error,
            self.scores,
            self.simulated_steps,
            self.counts,
            tuple(sorted(self.messages, key=self.messages.__getitem__))[:5],
            tuple(self.store.carries),
            self.log_weight + self.noise.log_ratio(),
            self.store.every,
            self._all_features(),
            self.noise.sums.T.copy() if self.request.until is not None else np.zeros((self.request.rows, 0)),
        )

    def _features(self, carry: Carry) -> Floats:
        verdict = carry.verdicts[0]
        verdict_features = monitor_features(
            self.specifications[0], carry.monitors[0], verdict.robustness, verdict.score
        )
        return np.concatenate([system_features(self.system, carry.system), verdict_features], axis=1)

    def _all_features(self) -> Floats:
        observe = self.request.observe
        size = max((values.shape[1] for _, values in self.features.values()), default=0)
        features = np.full((self.request.rows, len(observe), size), np.nan)
        for k, t in enumerate(observe):
            if t in self.features:
                rows, values = self.features[t]
                features[rows, k] = values
        return features

    def _begin(self, rows: Integers) -> tuple[Carry | None, Integers]:
        sample, alive = self._guard(
            lambda _, noise: self._sample(self.system.initial(noise), len(noise)),
            None,
            self.noise(rows, 0),
            rows,
        )
        monitors = tuple(spec.start(int(alive.sum())) for spec in self.specifications)
        return self._observe(sample, alive, monitors, rows, 0)

    def _advance(self, carry: Carry, rows: Integers, t: int) -> tuple[Carry | None, Integers]:
        sample, alive = self._guard(self._step, carry.system, self.noise(rows, t), rows)
        before = carry if alive.all() else batch.take(carry, alive)
        return self._observe(sample, alive, before.monitors, rows, t, before)

    def _join(
        self, carry: Carry | None, rows: Integers, newcomers: Carry, joining: Integers, t: int
    ) -> tuple[Carry, Integers]:
        self._count(newcomers, joining, -1)  # subtract what the parent has counted
        carry = newcomers if carry is None else batch.concatenate([carry, newcomers])
        rows = np.concatenate([rows, joining])
        self._record(carry, rows, t)
        return carry, rows

    def _step(self, state: object, noise: Floats) -> Sample:
        self.simulated_steps += len(noise)
        return self._sample(self.system.step(state, noise), len(noise))

    def _sample(self, state: object, n: int) -> Sample:
        signals = check_signals(self.system.signals(state), n)
        faulty = np.zeros(n, dtype=bool)
        faults = self.system.faults(state)
        if faults is not None:
            faulty |= check_rows("faults(state)", np.asarray(faults), n).astype(bool)
        for values in signals.values():
            faulty |= find_nan(values)
        return state, signals, faulty

    def _guard(
        self, function: Callable[[Any, Floats], Sample], state: object, noise: Floats, rows: Integers
    ) -> tuple[Sample | None, Bools]:
        # Apply ``function`` and drop rows that break down; bisect to find those that raise.
        if self.request.crash:  # they would end the process again
            self._collect_message(self.request.crash, rows)
            return None, np.zeros(len(noise), dtype=bool)
        try:
            sample = function(state, noise)
            self.raised = 0
        except (AvrareError, MemoryError):  # the machine's fault, not a rollout's
            raise
        except (Exception, SystemExit) as error:  # a plugin that calls exit(0) ends no program as passed
            if len(noise) == 1:
                self._collect_message(f"{type(error).__name__}: {error}", rows)
                self.raised += 1
                if self.raised == FIRST_ROLLOUTS and self.request.is_fresh:
                    raise EveryRolloutBroke.after(next(iter(self.messages))) from error
                return None, np.zeros(1, dtype=bool)
            return self._bisect(function, state, noise, rows)
        alive = ~sample[2]
        if alive.all():
            return sample, alive
        for text, place in _describe_faults(sample[1], ~alive):
            self._collect_message(text, rows[place])
        return (batch.take(sample, alive) if alive.any() else None), alive

    def _bisect(
        self, function: Callable[[Any, Floats], Sample], state: object, noise: Floats, rows: Integers
    ) -> tuple[Sample | None, Bools]:
        half = len(noise) // 2
        parts = [
            self._guard(function, None if state is None else batch.take(state, part), noise[part], rows[part])
            for part in (slice(0, half), slice(half, None))
        ]
        good = [sample for sample, _ in parts if sample is not None]
        return (batch.concatenate(good) if good else None), np.concatenate([alive for _, alive in parts])

    def _observe(
        self,
        sample: Sample | None,
        alive: Bools,
        monitors: tuple[object, ...],
        rows: Integers,
        t: int,
        before: Carry | None = None,
    ) -> tuple[Carry | None, Integers]:
        if not alive.all():
            self._drop(rows[~alive], t)
            rows = rows[alive]
        if sample is None:
            return None, rows
        state, signals, _ = sample
        updates = [
            spec.update(monitor, signals) for spec, monitor in zip(self.specifications, monitors, strict=True)
        ]
        carry = Carry(state, tuple(u[0] for u in updates), tuple(u[1] for u in updates))
        if before is not None:
            ended = self._find_ended(before.system, len(rows))
            if ended is not None and ended.any():  # what was judged before stays
                carry = replace(carry, verdicts=batch.choose(ended, before.verdicts, carry.verdicts))
        unknown = np.any([np.isnan(verdict.robustness) for verdict in carry.verdicts], axis=0)
        if unknown.any():
            text = "the formula has no value: log or sqrt of a negative number, infinity - infinity, or 0/0"
            self._collect_message(text, rows[unknown])
            self._drop(rows[unknown], t)
            carry, rows = batch.take(carry, ~unknown), rows[~unknown]
        if not rows.size:
            return None, rows
        self._record(carry, rows, t)
        return carry, rows

    def _collect_message(self, text: str, rows: Integers) -> None:
        # The order is that of the rows, whatever the chunk.
        first = int(rows.min())
        self.messages[text[:200]] = min(first, self.messages.get(text[:200], first))

    def _drop(self, rows: Integers, t: int) -> None:
        self.error[rows] = True
        if self.scored and t:  # the score of the last step before the error
            self.scores[rows, t:] = self.scores[rows, t - 1 : t]

    def _record(self, carry: Carry, rows: Integers, t: int) -> None:
        if self.scored:
            self.scores[rows, t] = carry.verdicts[0].score
        weights = self.system.log_weights(carry.system)
        if weights is not None:
            self.log_weight[rows] = weights
        for column, verdict in enumerate(carry.verdicts):
            self.robustness[rows, column] = verdict.robustness

    def _count(self, carry: Carry, rows: Integers, sign: int) -> None:
        for name, values in _ask("counts", self.system.counts, carry.system).items():
            numbers = check_rows(f"count {name!r}", values, len(rows))
            if numbers.dtype.kind not in "iub":
                raise UsageError(
                    f"count {name!r} holds {numbers.dtype}", "return integers from counts(state)"
                )
            self.counts.setdefault(name, np.zeros(self.request.rows, dtype=np.int64))[rows] += sign * numbers

    def _find_ended(self, state: object, n: int) -> Bools | None:
        ended = _ask("ended", self.system.ended, state)
        return None if ended is None else check_rows("ended(state)", ended, n).astype(bool)

    def _leave(self, carry: Carry, rows: Integers, t: int) -> tuple[Carry | None, Integers]:
        if not (self.request.stop_early or self.request.stop_failed):
            return carry, rows
        decided = np.all([state.decided for state in carry.monitors], axis=0)
        ended = self._find_ended(carry.system, len(rows))
        if ended is not None:
            decided |= ended
        if self.request.stop_failed:
            decided &= carry.verdicts[0].violated
        if not decided.any():
            return carry, rows
        self._finish(batch.take(carry, decided), rows[decided])
        if self.scored:
            self.scores[rows[decided], t:] = self.scores[rows[decided], t : t + 1]
        rest = rows[~decided]
        return (batch.take(carry, ~decided) if len(rest) else None), rest

    def _finish(self, carry: Carry, rows: Integers, final: bool = True) -> None:
        for column, verdict in enumerate(carry.verdicts):
            self.violated[rows, column] = verdict.violated & final
        self._count(carry, rows, 1)


def _ask(name: str, method: Callable[[Any], _AnswerT], state: object) -> _AnswerT:
    # An answer on all rows: no row can be blamed for its error.
    try:
        return method(state)
    except (AvrareError, MemoryError):
        raise
    except Exception as error:
        text = f"{name}(state) raised {type(error).__name__}: {error}"
        raise UsageError(text, "it is asked of all rollouts at once, and must answer") from error


class _Retrace(_Simulation):
    """Simulation that removes each row at its last step; ``reached`` maps a step to (rows, carry)."""

    def __init__(
        self, system: System, specifications: tuple[Specification, ...], until: Integers, request: Request
    ) -> None:
        steps = int(until.max())
        tape = TapeDrawer(NoiseSource(0, system.noise_size), request, steps)
        super().__init__(system, specifications, steps, tape, request, scored=False)
        self.until = until
        self.reached: dict[int, tuple[Integers, Carry]] = {}

    def _leave(self, carry: Carry, rows: Integers, t: int) -> tuple[Carry | None, Integers]:
        here = self.until[rows] == t
        if not here.any():
            return carry, rows
        self.reached[t] = rows[here], batch.take(carry, here)
        return (None if here.all() else batch.take(carry, ~here)), rows[~here]


def _restore_carries(
    system: System, specifications: tuple[Specification, ...], noise: NoiseSource, request: Request
) -> Request:
    past = request.past
    assert past is not None
    order = np.argsort(past.origin, kind="stable")
    rows = past.rows[order]
    until, run = request.start[rows], request.run[rows]
    steps = np.arange(int(until.max()) + 1)
    stage, particle = past.stage[order][:, steps], past.particle[order][:, steps]
    tape = draw_lineage(noise, request.tape_law, run[:, None], stage, particle)
    carries = tuple((step, carry) for step, _, carry in past.carries)
    retrace_request = Request(run, run, run, past.origin[order], carries, tape)
    retrace = _Retrace(system, specifications, until, retrace_request)
    if retrace.run().error.any():
        text = "a rollout broke down on noise on which it did not before"
        raise UsageError(f"{text}: the system does not depend on its noise alone")
    carried = np.ones(request.rows, dtype=bool)
    carried[rows] = False
    reached = {t: (rows[who], carry) for t, (who, carry) in retrace.reached.items()}
    merged = dict(request.carries)
    for t, (who, carry) in reached.items():
        if t in merged:
            who = np.concatenate([np.flatnonzero(carried & (request.start == t)), who])
            carry = batch.concatenate([merged[t], carry])
        merged[t] = batch.take(carry, np.argsort(who))
    return replace(request, carries=tuple(sorted(merged.items(), key=lambda pair: pair[0])))


def _describe_faults(signals: Signals, rows: Bools) -> Iterator[tuple[str, Integers]]:
    """Yield each way in which these rows (N,) broke down, and the places of the rows that did."""
    places = np.flatnonzero(rows)
    broken = np.array([np.full(len(places), True), *(find_nan(values[rows]) for values in signals.values())])
    for way in np.unique(broken, axis=1).T:
        names = [name for name, is_present in zip(signals, way[1:], strict=True) if is_present]
        nan = f"NaN in signal{'s' * (len(names) > 1)} {', '.join(names)}"
        alike = places[(broken == way[:, None]).all(axis=0)]
        yield nan if names else "fault reported by the system", alike
