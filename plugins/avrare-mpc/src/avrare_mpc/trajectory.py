"""Scripted vehicles: one plan over the whole drive that looks at nobody else."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from avrare.driving import Road
from avrare.errors import UsageError
from avrare_mpc.config import TrajectoryPlan
from avrare_mpc.nlp import Node, NodeCost, build_nlp, lane_cost
from avrare_mpc.plan import STAGE, STATES
from avrare_mpc.uninterrupted import uninterrupted

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Trajectory:
    """Samples of a scripted vehicle, each field (steps,); units as in ``avrare.driving.Vehicles``.

    Attributes:
        x: [m].
        y: [m].
        heading: [rad].
        speed: [m/s].
        acceleration: Applied from a sample to the next one; 0 at the last one [m/s^2].
    """

    x: Floats
    y: Floats
    heading: Floats
    speed: Floats
    acceleration: Floats


def plan_trajectory(
    plan: TrajectoryPlan,
    start_x: float,
    start_y: float,
    start_speed: float,
    start_heading: float,
    road: Road,
    dt: float,
) -> Trajectory:
    """Solve for the whole trajectory at once, from zeros, with tight tolerances.

    Args:
        plan: Goals, weights and lane schedule.
        start_x: [m].
        start_y: [m].
        start_speed: [m/s].
        start_heading: [rad].
        road: The lanes that ``plan`` speaks of.
        dt: Step [s].

    Raises:
        UsageError: A lane does not exist, or there is no such trajectory.
    """
    used = {*plan.lanes, *plan.fixed_lanes().values()}
    if max(used) >= len(road.lane_centres):
        raise UsageError(f"lane {max(used)} does not exist, the road has {len(road.lane_centres)} lanes")
    nlp = build_nlp(plan, plan.steps - 1, dt, (plan.y_min, plan.y_max), _lane_costs(plan, road), ca.SX(0, 1))
    options: dict[str, Any] = {
        "print_time": False,
        "show_eval_warnings": False,
        "ipopt": {"print_level": 0, "sb": "yes", "tol": 1e-10, "max_iter": 3000},
    }
    problem = {"x": nlp.variables, "p": nlp.parameters, "f": nlp.cost, "g": nlp.constraints}
    solver = ca.nlpsol("trajectory", "ipopt", problem, options)
    start = [start_x, start_y, start_speed, start_heading]
    with uninterrupted():
        found = solver(x0=0.0, p=start, lbg=nlp.lower, ubg=nlp.upper)
    stats = solver.stats()
    if not stats["success"]:
        raise UsageError(
            f"no trajectory from x={start_x}, y={start_y}, v={start_speed}: {stats['return_status']}",
            hint="loosen the bounds of the plan",
        )
    return _samples(np.asarray(found["x"]).ravel())


def _lane_costs(plan: TrajectoryPlan, road: Road) -> NodeCost:
    fixed = plan.fixed_lanes()

    def cost(step: int, node: Node) -> ca.SX:
        lanes = (fixed[step],) if step in fixed else plan.lanes
        return plan.lane_weight * lane_cost(node.y, tuple(road.lane_centres[lane] for lane in lanes))

    return cost


def _samples(flat: Floats) -> Trajectory:
    stages = np.append(flat, np.zeros(STAGE - STATES)).reshape(-1, STAGE)
    return Trajectory(
        x=stages[:, 0].copy(),
        y=stages[:, 1].copy(),
        speed=stages[:, 2].copy(),
        heading=stages[:, 3].copy(),
        acceleration=stages[:, STATES].copy(),
    )
