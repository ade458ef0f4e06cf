"""Glider model: flat plates for wing and elevator, in still air, in the vertical plane.

Model of Roberts, Cory and Tedrake (*On the controllability of fixed-wing perching*, American Control
Conference 2009); numbers of the "R1" glider as in Drake's example of the perching glider, after
Moore, Cory and Tedrake (*Robust post-stall perching with a simple fixed-wing glider using LQR-trees*, 2014).
A flat plate of area S that moves through air with velocity v at the angle of attack a is pushed along its
normal by density S |v|^2 sin(a), before the stall and after it. The wing's centre is the centre of mass.

Functions take seven columns in the order of ``NAMES``: floats, complex numbers (for derivatives) or symbols.
They are arithmetic, sines and roots of columns: no row depends on its neighbours.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

NAMES = ("x", "z", "pitch", "elevator", "vx", "vz", "pitch_rate")
"""Forward, up [m]; nose up, elevator against the fuselage, trailing edge down [rad]; rates of x, z, pitch."""
DT = 0.01
"""Step [s]."""
MASS, INERTIA = 0.08, 0.0015  # [kg], [kg m^2]
WING, ELEVATOR = 0.0885, 0.0147  # areas [m^2]; the wing's includes fuselage and tail
HINGE, CHORD = 0.27, 0.022  # centre of mass to hinge, hinge to the middle of the elevator [m]
DENSITY, GRAVITY = 1.204, 9.81  # [kg/m^3], [m/s^2]
ELEVATOR_STOPS = (-0.9473, 0.4463)  # [rad]
RATE_LIMIT = 13.0
"""Limit of the servo in either direction [rad/s]."""
START = (-3.5, 0.1, 0.0, 0.0, 7.0, 0.0, 0.0)
"""Nominal state at t = 0. The wire is at x = z = 0."""

Columns = tuple[Any, ...]


def rates(state: Columns, elevator_rate: Any, math: Any = np) -> Columns:
    """Return the time derivatives of the seven columns.

    Args:
        state: Seven columns, see ``NAMES``.
        elevator_rate: Input [rad/s], same shape as a column.
        math: Module with ``sin``, ``cos`` and ``sqrt`` for such columns.
    """
    _, _, pitch, elevator, vx, vz, turn = state
    sine, cosine = math.sin(pitch), math.cos(pitch)
    bend, straight = math.sin(elevator), math.cos(elevator)
    up, along = sine * straight + cosine * bend, cosine * straight - sine * bend  # sine, cosine of both
    swing = CHORD * (turn + elevator_rate)
    tail_x = vx + HINGE * turn * sine + swing * up
    tail_z = vz - HINGE * turn * cosine - swing * along
    smoothing = 1e-10  # keeps the root smooth at rest [m^2/s^2]
    wing_speed = math.sqrt(vx * vx + vz * vz + smoothing)
    tail_speed = math.sqrt(tail_x * tail_x + tail_z * tail_z + smoothing)
    wing = DENSITY * WING * (sine * vx - cosine * vz) * wing_speed  # along the plate's normal, backwards
    tail = DENSITY * ELEVATOR * (up * tail_x - along * tail_z) * tail_speed
    return (
        vx,
        vz,
        turn,
        elevator_rate,
        -(wing * sine + tail * up) / MASS,
        (wing * cosine + tail * along) / MASS - GRAVITY,
        -tail * (HINGE * straight + CHORD) / INERTIA,
    )


def advance(state: Columns, elevator_rate: ArrayLike) -> Columns:
    """Return the columns one step later at a constant input, by the classical Runge-Kutta method."""
    first = rates(state, elevator_rate)
    second = rates(_move(state, first, 0.5 * DT), elevator_rate)
    third = rates(_move(state, second, 0.5 * DT), elevator_rate)
    fourth = rates(_move(state, third, DT), elevator_rate)
    slopes = zip(first, second, third, fourth, strict=True)
    return _move(state, tuple((a + 2.0 * (b + c) + d) / 6.0 for a, b, c, d in slopes), DT)


def _move(state: Columns, slope: Columns, time: float) -> Columns:
    return tuple(s + time * v for s, v in zip(state, slope, strict=True))
