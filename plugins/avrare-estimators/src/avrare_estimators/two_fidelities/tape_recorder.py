"""Recorder: plain rollouts of chosen tapes whose outcomes are kept row by row, for estimates in phases."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from avrare.estimation.checks.result_builder import build_result, represent_errors
from avrare.estimation.plan.memory import Demand
from avrare.estimation.plan.plan import Estimator, Info, Plan
from avrare.estimation.result import intervals
from avrare.estimation.result.result import Failures, Result, Worst
from avrare.protocols import Bools, Floats
from avrare.rollout.noise import NoiseSource
from avrare.rollout.request import Integers, Request, Rollouts


@dataclass(frozen=True)
class Record:
    """Outcomes of tapes, of S specifications.

    Attributes:
        violated: (n, S) verdicts; False where the rollout broke down.
        robustness: (n, S) NaN where the rollout broke down.
        error: (n,) True where the rollout broke down.
        messages: Causes of the first few errors.
    """

    violated: Bools
    robustness: Floats
    error: Bools
    messages: tuple[str, ...]


@dataclass(frozen=True, repr=False, kw_only=True)
class _RecordedResult(Result):
    record: Record


@dataclass(frozen=True)
class _State:
    plan: Plan
    parts: tuple[Record, ...]
    info: Info


class Recorder(Estimator):
    """Estimator of a phase: its results have the cost and the failures of the rollouts, and no interval yet.

    Args:
        particles: (n,) numbers of the tapes, of run 0 and stage 0 of the seed: those of Monte Carlo.
    """

    name = "mfmc"
    single = False

    def __init__(self, particles: Integers) -> None:
        self.particles = particles

    def init(self, plan: Plan) -> tuple[_State, Info]:
        """Return the state before the first rollout, and the progress to show."""
        info = Info(goal=len(self.particles))
        return _State(plan, (), info), info

    def demand(self, plan: Plan, carry: int) -> Demand:
        """Return the memory of the outcomes."""
        return Demand(2 * len(self.particles) * (9 * len(plan.names) + 9), None, "rollouts")

    def ask(self, state: _State) -> Request | None:
        """Return the next tapes, None when all are run."""
        done = state.info.rollouts
        particles = self.particles[done : done + 2**15]
        return Request.from_start(np.zeros_like(particles), particles) if len(particles) else None

    def tell(self, state: _State, rollouts: Rollouts) -> tuple[_State, Info]:
        """Keep the outcomes."""
        robustness = np.where(rollouts.error[:, None], np.nan, rollouts.robustness)
        part = Record(rollouts.violated, robustness, rollouts.error, rollouts.messages)
        state = replace(state, parts=(*state.parts, part), info=state.info.plus(rollouts))
        return state, state.info

    def estimate(self, state: _State) -> list[Result]:
        """Return one result per specification: the share of failures, and the record."""
        names, record = state.plan.names, _join_records(state.parts, len(state.plan.names))
        return [self._result(state, record, column) for column in range(len(names))]

    def _result(self, state: _State, record: Record, column: int) -> Result:
        plan, violated = state.plan, record.violated[:, column]
        robustness = record.robustness[:, column]
        worst = represent_errors(plan)
        if not np.isnan(robustness).all():
            least = int(np.nanargmin(robustness))
            worst = Worst(
                draw_tapes(plan.noise, plan.steps, self.particles[[least]])[0], float(robustness[least])
            )
        failures = Failures(worst.noise[None][:0], robustness[:0], int(violated.sum()))
        values = np.array([float(violated.mean()) if len(violated) else 0.0])
        result = build_result(
            plan,
            self.name,
            state.info,
            values,
            column,
            interval_at=intervals.unknown,
            relative_error=math.nan,
            health={},
            failures=failures,
            worst=worst,
            robustness=robustness,
        )
        return _RecordedResult(**vars(result), record=record)


def draw_tapes(noise: NoiseSource, steps: int, particles: Integers) -> Floats:
    """Return the tapes (n, steps + 1, noise_size) of particles of run 0 and stage 0."""
    return noise.normals(0, 0, particles[:, None], np.arange(steps + 1))


def take_record(results: list[Result]) -> Record:
    """Return the record of a recorder's results."""
    result = results[0]
    assert isinstance(result, _RecordedResult)
    return result.record


def _join_records(parts: tuple[Record, ...], specifications: int) -> Record:
    none = np.zeros((0, specifications))
    return Record(
        np.concatenate([none.astype(bool), *(record.violated for record in parts)]),
        np.concatenate([none, *(record.robustness for record in parts)]),
        np.concatenate([none[:, 0].astype(bool), *(record.error for record in parts)]),
        tuple(dict.fromkeys(text for record in parts for text in record.messages))[:5],
    )
