"""The rollout engine: advances a batch of particles through time, from the start or from stored carries.

All rows that are alive stand at the same step t; a row that starts at step s joins when t reaches s. A row
that breaks down leaves the batch, keeps its score, and is reported as an error: never as a pass or a failure.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from avrare import batch
from avrare.errors import AvrareError, UsageError
from avrare.protocols import Bools, Floats, Signals, Specification, System
from avrare.rollout.noise import NoiseSource
from avrare.rollout.request import Carry, Integers, Request, Rollouts

Sample = tuple[Any, dict[str, Any], Bools]
"""State, signals and rows that have broken down."""


def simulate(
    system: System,
    specifications: tuple[Specification, ...],
    steps: int,
    noise: NoiseSource,
    request: Request,
) -> Rollouts:
    """Run the rows of ``request`` to step ``steps`` (or to their breakdown)."""
    return _Rollout(system, specifications, steps, noise, request).run()


class _Rollout:
    def __init__(
        self, system: System, specifications: tuple[Specification, ...], steps: int, noise: NoiseSource,
        request: Request,
    ) -> None:  # fmt: skip
        self.system, self.specifications, self.steps = system, specifications, steps
        self.noise, self.request = noise, request
        rows, count = request.rows, len(specifications)
        self.robustness = np.full((rows, count), np.inf)
        self.violated = np.zeros((rows, count), dtype=bool)
        self.error = np.zeros(rows, dtype=bool)
        self.scores = np.full((rows, steps + 1), -np.inf)
        self.simulated_steps = 0
        self.counts: dict[str, Integers] = {}
        self.messages: list[str] = []
        self.kept: list[tuple[int, Integers, Carry]] = []

    def run(self) -> Rollouts:
        carries = dict(self.request.carries)
        first = int(self.request.start[0]) if self.request.rows else self.steps
        carry: Carry | None = None
        rows = np.zeros(0, dtype=np.int64)
        for t in range(max(first, 0), self.steps + 1):
            if carry is not None:
                carry, rows = self._advance(carry, rows, t)
            joining = np.flatnonzero(self.request.start == (t if t or first >= 0 else -1))
            if t == 0 and first < 0:
                carry, rows = self._begin(joining)
                joining = np.flatnonzero(self.request.start == 0)
            if joining.size:
                carry = carries[t] if carry is None else batch.concatenate([carry, carries[t]])
                rows = np.concatenate([rows, joining])
                self._record(carry, rows, t)
            if carry is not None and self.request.keep_carries:
                self.kept.append((t, rows, carry))
        if carry is not None:
            self._finish(carry, rows)
        return Rollouts(
            self.robustness, self.violated, self.error, self.scores, self.simulated_steps, self.counts,
            tuple(dict.fromkeys(self.messages))[:5], tuple(self.kept),
        )  # fmt: skip

    def _noise(self, rows: Integers, t: int) -> Floats:
        request = self.request
        if request.tape is not None:
            return np.ascontiguousarray(request.tape[rows, t])
        return self.noise.normals(request.run[rows], request.stage[rows], request.particle[rows], t)

    def _begin(self, rows: Integers) -> tuple[Carry | None, Integers]:
        sample, alive = self._guard(lambda _, noise: self._initial(noise), None, self._noise(rows, 0))
        monitors = tuple(spec.start(int(alive.sum())) for spec in self.specifications)
        return self._observe(sample, alive, monitors, rows, 0)

    def _advance(self, carry: Carry, rows: Integers, t: int) -> tuple[Carry | None, Integers]:
        sample, alive = self._guard(self._step, carry.system, self._noise(rows, t))
        monitors = carry.monitors if alive.all() else batch.take(carry.monitors, alive)
        if not alive.all():
            self.scores[rows[~alive], t:] = carry.verdicts[0].score[~alive, None]
        return self._observe(sample, alive, monitors, rows, t)

    def _initial(self, noise: Floats) -> Sample:
        return self._sample(self.system.initial(noise), len(noise))

    def _step(self, state: Any, noise: Floats) -> Sample:
        self.simulated_steps += len(noise)
        return self._sample(self.system.step(state, noise), len(noise))

    def _sample(self, state: Any, n: int) -> Sample:
        signals = dict(_checked(self.system.signals(state), n))
        broken = np.zeros(n, dtype=bool)
        faults = getattr(self.system, "faults", None)
        if faults is not None:
            broken |= np.asarray(faults(state), dtype=bool)
        for values in signals.values():
            if values.dtype.kind == "f":
                broken |= np.isnan(values).reshape(n, -1).any(axis=1)
        return state, signals, broken

    def _guard(
        self, function: Callable[[Any, Floats], Sample], state: Any, noise: Floats
    ) -> tuple[Sample | None, Bools]:
        """Apply ``function``; on an exception bisect to the rows that cause it. Broken rows are dropped."""
        try:
            sample = function(state, noise)
        except AvrareError:
            raise
        except Exception as error:
            if len(noise) == 1:
                self.messages.append(f"{type(error).__name__}: {error}"[:200])
                return None, np.zeros(1, dtype=bool)
            return self._bisect(function, state, noise)
        alive = ~sample[2]
        if alive.all():
            return sample, alive
        self.messages.append("NaN signal or fault reported by the system")
        return (batch.take(sample, alive) if alive.any() else None), alive

    def _bisect(
        self, function: Callable[[Any, Floats], Sample], state: Any, noise: Floats
    ) -> tuple[Sample | None, Bools]:
        half = len(noise) // 2
        parts = [
            self._guard(function, None if state is None else batch.take(state, part), noise[part])
            for part in (slice(0, half), slice(half, None))
        ]
        good = [sample for sample, _ in parts if sample is not None]
        return (batch.concatenate(good) if good else None), np.concatenate([alive for _, alive in parts])

    def _observe(
        self, sample: Sample | None, alive: Bools, monitors: tuple[Any, ...], rows: Integers, t: int
    ) -> tuple[Carry | None, Integers]:
        self.error[rows[~alive]] = True
        rows = rows[alive]
        if sample is None:
            return None, rows
        state, signals, _ = sample
        updates = [
            spec.update(monitor, signals) for spec, monitor in zip(self.specifications, monitors, strict=True)
        ]
        carry = Carry(state, tuple(u[0] for u in updates), tuple(u[1] for u in updates))
        self._record(carry, rows, t)
        return carry, rows

    def _record(self, carry: Carry, rows: Integers, t: int) -> None:
        self.scores[rows, t] = carry.verdicts[0].score
        for column, verdict in enumerate(carry.verdicts):
            self.robustness[rows, column] = verdict.robustness

    def _finish(self, carry: Carry, rows: Integers) -> None:
        for column, verdict in enumerate(carry.verdicts):
            self.violated[rows, column] = verdict.violated
        counts = getattr(self.system, "counts", None)
        if counts is not None:
            for name, values in counts(carry.system).items():
                self.counts[name] = np.zeros(self.request.rows, dtype=np.int64)
                self.counts[name][rows] = values


def _checked(signals: Signals, n: int) -> Signals:
    for name, values in signals.items():
        if not isinstance(values, np.ndarray) or values.ndim == 0 or values.shape[0] != n:
            shape = getattr(values, "shape", type(values).__name__)
            raise UsageError(
                f"signal {name!r} has shape {shape}, but a batch of {n} particles needs ({n},) or ({n}, ...)",
                "return NumPy arrays with one entry a particle",
            )
    return signals
