"""The model that plans are made with: a unicycle, explicit Euler."""

from __future__ import annotations

import math

from avrare_mpc.riccati.jit import kernel
from avrare_mpc.riccati.values import Floats, Path, Programme

MARGIN = 0.995
"""Part of the way to a bound that a step may go."""


@kernel
def drive(p: Programme, path: Path) -> None:
    """Fill the states of ``path`` from its first one and its inputs."""
    for k in range(len(path.inputs)):
        _advance(p, path, k)
    _turn(path, len(path.inputs))


@kernel
def follow(p: Programme, path: Path, trial: Path, gains: Floats, step: float) -> None:
    """Fill ``trial`` with the drive whose inputs are those of ``path``, moved by ``step`` and fed back.

    The feedback of the Riccati sweep makes up for what its linear model of the drive leaves out.
    """
    for i in range(4):
        trial.states[0, i] = path.states[0, i]
    before = 0.0
    for k in range(len(path.inputs)):
        x, y = trial.states[k, 0] - path.states[k, 0], trial.states[k, 1] - path.states[k, 1]
        v, h = trial.states[k, 2] - path.states[k, 2], trial.states[k, 3] - path.states[k, 3]
        gain = gains[k]
        a = step * gain[0] + gain[1] * x + gain[2] * y + gain[3] * v + gain[4] * h + gain[5] * before
        w = step * gain[6] + gain[7] * x + gain[8] * y + gain[9] * v + gain[10] * h + gain[11] * before
        trial.inputs[k, 0] = _inside(path.inputs[k, 0], a, p.acceleration_max)
        trial.inputs[k, 1] = _inside(path.inputs[k, 1], w, p.turn_rate_max)
        before = trial.inputs[k, 1] - path.inputs[k, 1]
        _advance(p, trial, k)
    _turn(trial, len(path.inputs))


@kernel
def _inside(value: float, move: float, limit: float) -> float:
    """The value moved, but no nearer to its bounds than a part of the way."""
    return value + max(min(move, MARGIN * (limit - value)), -MARGIN * (limit + value))


@kernel
def _turn(path: Path, k: int) -> None:
    path.cosine[k], path.sine[k] = math.cos(path.states[k, 3]), math.sin(path.states[k, 3])


@kernel
def _advance(p: Programme, path: Path, k: int) -> None:
    """The state after node ``k``."""
    _turn(path, k)
    v = path.states[k, 2]
    path.states[k + 1, 0] = path.states[k, 0] + p.dt * v * path.cosine[k]
    path.states[k + 1, 1] = path.states[k, 1] + p.dt * v * path.sine[k]
    path.states[k + 1, 2] = v + p.dt * path.inputs[k, 0]
    path.states[k + 1, 3] = path.states[k, 3] + p.dt * path.inputs[k, 1]
