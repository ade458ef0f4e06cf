"""Plans as arrays, and the memory that a particle carries from step to step."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Bools = NDArray[np.bool_]

STATES = 5
"""States of a stage of the programme: x, y, speed, heading, turn rate of the step before."""
STAGE = 8
"""Its variables: the states, acceleration, turn rate, lateral slack."""


@dataclass(frozen=True)
class Memory:
    """The last plan and counters of N particles.

    Attributes:
        plan_states: (N, H + 1, 4) x, y, speed, heading; entry 0 belongs to the step just acted on.
        plan_inputs: (N, H, 2) acceleration, turn rate; entry 0 was the last action.
        solved: (N,) there is a plan; False at the start and after a plan has been used up by failures.
        age: (N,) steps since the plan was solved for.
        solves: (N,) programmes handed to a solver, several at a first step.
        retries: (N,) how many of them the first attempt failed on, so that a second one was made.
        fallbacks: (N,) steps without a new plan, driven on the old one or braking.
        start_policy: (N,) which start drive gave the first plan; -1 before there is one.
    """

    plan_states: Floats
    plan_inputs: Floats
    solved: Bools
    age: Integers
    solves: Integers
    retries: Integers
    fallbacks: Integers
    start_policy: Integers


def empty_memory(n: int, steps: int) -> Memory:
    """Memory of ``n`` particles without a plan of ``steps`` steps."""
    zeros = np.zeros(n, dtype=np.int64)
    return Memory(
        plan_states=np.zeros((n, steps + 1, 4)),
        plan_inputs=np.zeros((n, steps, 2)),
        solved=np.zeros(n, dtype=np.bool_),
        age=zeros,
        solves=zeros.copy(),
        retries=zeros.copy(),
        fallbacks=zeros.copy(),
        start_policy=np.full(n, -1, dtype=np.int64),
    )


def shift(states: Floats, inputs: Floats, dt: float) -> tuple[Floats, Floats]:
    """The plan one step later: its last state rolls on without acceleration and turning."""
    x, y, speed, heading = np.moveaxis(states[:, -1:], -1, 0)
    last = [x + dt * speed * np.cos(heading), y + dt * speed * np.sin(heading), speed, heading]
    later_states = np.concatenate([states[:, 1:], np.stack(last, axis=-1)], axis=1)
    later_inputs = np.concatenate([inputs[:, 1:], np.zeros_like(inputs[:, :1])], axis=1)
    return later_states, later_inputs


def to_variables(states: Floats, inputs: Floats) -> Floats:
    """Plans (..., H + 1, 4) and (..., H, 2) as rows (..., 8 H + 5) of the programme's variables."""
    stages = np.zeros((*states.shape[:-1], STAGE))
    stages[..., :4] = states
    stages[..., 1:, 4] = inputs[..., 1]
    stages[..., :-1, STATES : STATES + 2] = inputs
    flat = stages.reshape(*states.shape[:-2], states.shape[-2] * STAGE)
    return flat[..., : STATES - STAGE]


def from_variables(variables: Floats) -> tuple[Floats, Floats]:
    """Plans (N, H + 1, 4) and (N, H, 2) in rows (N, 8 H + 5) of the programme's variables."""
    padded = np.concatenate([variables, np.zeros((len(variables), STAGE - STATES))], axis=1)
    stages = padded.reshape(len(variables), -1, STAGE)
    return stages[:, :, :4].copy(), stages[:, :-1, STATES : STATES + 2].copy()
