"""Trajectories of scripted vehicles: one plan over all steps that ignores other vehicles."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from avrare.base.errors import UsageError
from avrare.driving import Road
from avrare.protocols import Floats
from avrare_mpc.config import TrajectoryPlan
from avrare_mpc.nlp import Node, NodeCost, build_nlp, lane_cost
from avrare_mpc.plan import STAGE, STATES
from avrare_mpc.signal_guard import defer_signals


@dataclass(frozen=True)
class Trajectory:
    """Samples of a scripted vehicle, each field (steps,).

    Attributes:
        x: Position along the road [m].
        y: Position across the road [m].
        heading: Heading [rad].
        speed: Speed [m/s].
        acceleration: Acceleration from a sample to the next one; 0 at the last one [m/s^2].
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
    """Solve for the trajectory, from zeros, with tight tolerances.

    Args:
        plan: Goals, weights and lane schedule.
        start_x: Initial position along the road [m].
        start_y: Initial position across the road [m].
        start_speed: Initial speed [m/s].
        start_heading: Initial heading [rad].
        road: Lanes that ``plan`` refers to.
        dt: Step [s].

    Raises:
        UsageError: A lane does not exist, or the solver finds no trajectory.
    """
    used = {*plan.lanes, *plan.fixed_lanes().values()}
    if max(used) >= len(road.lane_centres):
        lanes = f"the lanes are numbered 0 to {len(road.lane_centres) - 1}"
        raise UsageError(f"lane {max(used)} does not exist: {lanes}", "change the lanes of the plan")
    nlp = build_nlp(plan, plan.steps - 1, dt, (plan.y_min, plan.y_max), _lane_costs(plan, road), ca.SX(0, 1))
    options: dict[str, Any] = {
        "print_time": False,
        "show_eval_warnings": False,
        "ipopt": {"print_level": 0, "sb": "yes", "tol": 1e-10, "max_iter": 3000},
    }
    problem = {"x": nlp.variables, "p": nlp.parameters, "f": nlp.cost, "g": nlp.constraints}
    solver = ca.nlpsol("trajectory", "ipopt", problem, options)
    start = [start_x, start_y, start_speed, start_heading, 0.0]
    with defer_signals():
        trajectory = solver(x0=0.0, p=start, lbg=nlp.lower, ubg=nlp.upper)
    stats = solver.stats()
    if not stats["success"]:
        raise UsageError(
            f"no trajectory from x={start_x}, y={start_y}, v={start_speed}: {stats['return_status']}",
            hint="loosen the bounds of the plan",
        )
    stages = np.append(np.asarray(trajectory["x"]).ravel(), np.zeros(STAGE - STATES)).reshape(-1, STAGE)
    column = stages.T.copy()
    return Trajectory(column[0], column[1], column[3], column[2], column[STATES])


def _lane_costs(plan: TrajectoryPlan, road: Road) -> NodeCost:
    fixed = plan.fixed_lanes()

    def cost(step: int, node: Node) -> ca.SX:
        lanes = (fixed[step],) if step in fixed else plan.lanes
        return plan.lane_weight * lane_cost(node.y, tuple(road.lane_centres[lane] for lane in lanes))

    return cost
