"""The optimal control problem as one nonlinear programme, ordered by stages.

Every node has the state (x, y, v, h, w of the step before); every stage but the last node also has the inputs
(a, w) and the lateral slack. Two exact reformulations keep structured solvers happy:

* The cost of w[k] - w[k-1] couples neighbouring stages only through the remembered w.
* The last node has no inputs. Its acceleration would be 0 and its turn rate c / (c + r) w[H-1] (change
  weight c, turn rate weight r); what is left of their cost is c r / (c + r) w[H-1]^2.

The lateral bounds are exact penalties, not constraints: a disturbed plant may leave them and must get back.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from avrare_mpc.config import PlannerConfig
from avrare_mpc.plan import STATES

Floats = NDArray[np.float64]
NodeCost = Callable[[int, "Node"], ca.SX]


@dataclass(frozen=True)
class Node:
    """Symbols of one node; the inputs of the last one are the constant 0."""

    state: ca.SX
    acceleration: ca.SX
    turn_rate: ca.SX
    slack: ca.SX
    last: bool

    @property
    def y(self) -> ca.SX:
        """Lateral position [m]."""
        return self.state[1]

    @property
    def speed(self) -> ca.SX:
        """Speed [m/s]."""
        return self.state[2]

    @property
    def heading(self) -> ca.SX:
        """Heading [rad]."""
        return self.state[3]


@dataclass(frozen=True)
class Nlp:
    """A nonlinear programme: minimise cost subject to lower <= constraints <= upper.

    Attributes:
        variables: (8 H + 5,) symbols, stage by stage.
        parameters: (4 + extra,) symbols: initial state, then what the node costs use.
        cost: Scalar expression.
        constraints: (M,) expressions, stage by stage, the dynamics of a stage first.
        lower: (M,).
        upper: (M,).
    """

    variables: ca.SX
    parameters: ca.SX
    cost: ca.SX
    constraints: ca.SX
    lower: Floats
    upper: Floats


def lane_cost(y: ca.SX, centres: tuple[float, ...]) -> ca.SX:
    """The smallest sum of (s_i d_i)^2 over weights s_i >= 0 that add up to 1: 1 / sum(1 / d_i^2).

    Written with products so that it is defined on a lane's centre, too.
    """
    squares = [(y - centre) ** 2 for centre in centres]
    others = [ca.SX(1.0)] * len(squares)
    for i in range(len(squares)):
        for j, square in enumerate(squares):
            if i != j:
                others[i] = others[i] * square
    total = others[0]
    for other in others[1:]:
        total = total + other
    return squares[0] * others[0] / total


def build_nlp(
    planner: PlannerConfig,
    steps: int,
    dt: float,
    y_bounds: tuple[float, float],
    node_cost: NodeCost,
    extra: ca.SX,
) -> Nlp:
    """The programme of a plan of ``steps`` steps.

    Args:
        planner: Goals, weights and bounds.
        steps: H.
        dt: Step [s].
        y_bounds: Soft bounds of the lateral position [m].
        node_cost: Cost of node 0..H beyond the common terms.
        extra: Symbols of the parameters that ``node_cost`` uses.
    """
    start = ca.SX.sym("start", 4)
    nodes = [_node(k, k == steps) for k in range(steps + 1)]
    cost = ca.SX(0.0)
    rows: list[tuple[ca.SX, float, float]] = []
    for k, node in enumerate(nodes):
        cost += _common_cost(planner, node, first=k == 0) + node_cost(k, node)
        if k < steps:
            rows += [(gap, 0.0, 0.0) for gap in _gaps(node, nodes[k + 1], dt)]
        if k == 0:
            rows += [(row, 0.0, 0.0) for row in ca.vertsplit(node.state - ca.vertcat(start, 0.0))]
        rows += _bounds(planner, node, dt, y_bounds, first=k == 0)
    return Nlp(
        variables=ca.vertcat(*(_symbols(node) for node in nodes)),
        parameters=ca.vertcat(start, extra),
        cost=cost,
        constraints=ca.vertcat(*(row for row, _, _ in rows)),
        lower=np.array([low for _, low, _ in rows]),
        upper=np.array([high for _, _, high in rows]),
    )


def _node(k: int, last: bool) -> Node:
    state = ca.SX.sym(f"state{k}", STATES)
    if last:
        return Node(state, ca.SX(0.0), ca.SX(0.0), ca.SX(0.0), last=True)
    return Node(state, ca.SX.sym(f"a{k}"), ca.SX.sym(f"w{k}"), ca.SX.sym(f"slack{k}"), last=False)


def _symbols(node: Node) -> ca.SX:
    if node.last:
        return node.state
    return ca.vertcat(node.state, node.acceleration, node.turn_rate, node.slack)


def _common_cost(planner: PlannerConfig, node: Node, first: bool) -> ca.SX:
    cost = (
        planner.y_goal_weight * (node.y - planner.y_goal) ** 2
        + planner.v_goal_weight * (node.speed - planner.v_goal) ** 2
        + planner.heading_weight * node.heading**2
    )
    change, rate = planner.turn_rate_change_weight, planner.turn_rate_weight
    if node.last:
        return cost + (change * rate / (change + rate) if change + rate else 0.0) * node.state[4] ** 2
    cost += planner.acceleration_weight * node.acceleration**2
    cost += planner.braking_weight * ca.fmin(0.0, node.acceleration) ** 2
    cost += rate * node.turn_rate**2 + planner.y_penalty * node.slack
    return cost if first else cost + change * (node.turn_rate - node.state[4]) ** 2


def _gaps(node: Node, following: Node, dt: float) -> list[ca.SX]:
    """The unicycle, explicit Euler."""
    x, y, speed, heading, _ = ca.vertsplit(node.state)
    reached = (
        x + dt * speed * ca.cos(heading),
        y + dt * speed * ca.sin(heading),
        speed + dt * node.acceleration,
        heading + dt * node.turn_rate,
        node.turn_rate,
    )
    return [following.state[i] - value for i, value in enumerate(reached)]


def _bounds(
    planner: PlannerConfig, node: Node, dt: float, y_bounds: tuple[float, float], first: bool
) -> list[tuple[ca.SX, float, float]]:
    rows: list[tuple[ca.SX, float, float]] = []
    if not first:  # the first node is given
        rows.append((node.speed, planner.speed_min, planner.speed_max))
        rows.append((node.heading, -planner.heading_max, planner.heading_max))
    if not node.last:
        rows.append((node.acceleration, -planner.acceleration_max, planner.acceleration_max))
        rows.append((node.turn_rate, -planner.turn_rate_max, planner.turn_rate_max))
        rows.append((node.slack, 0.0, np.inf))
        # bounding the next node here spares the last node an input
        following = node.y + dt * node.speed * ca.sin(node.heading)
        rows.append((following - node.slack, -np.inf, y_bounds[1]))
        rows.append((following + node.slack, y_bounds[0], np.inf))
    return rows
