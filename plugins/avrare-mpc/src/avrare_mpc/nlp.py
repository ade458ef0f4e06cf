"""Nonlinear programmes of optimal control problems, ordered by stages; that of the controller.

Every node has the state (x, y, v, h, w of the previous step); every node but the last also has the inputs
(a, w) and the lateral slack. Two exact reformulations give the structure that stage-wise solvers need:

* The cost of w[k] - w[k-1] couples neighbouring stages only through the previous w in the state.
* The last node has no inputs. Its optimal acceleration is 0 and its optimal turn rate c / (c + r) w[H-1]
  (change weight c, turn rate weight r), which leaves a cost of c r / (c + r) w[H-1]^2.

The lateral bounds are exact penalties, not constraints: a disturbed plant may leave them and must return.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca
import numpy as np

from avrare.driving import Scene
from avrare.protocols import Floats
from avrare_mpc.config import MpcConfig, PlannerConfig
from avrare_mpc.plan import STATES, lane_centres, lateral_bounds

NodeCost = Callable[[int, "Node"], ca.SX]


@dataclass(frozen=True)
class Node:
    """Symbols of one node; the inputs of the last node are the constant 0."""

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
    """Nonlinear programme: minimise cost subject to lower <= constraints <= upper.

    Attributes:
        variables: (8 H + 5,) symbols, stage by stage.
        parameters: (5 + extra,) symbols: initial state, then what the node costs use.
        cost: Scalar expression.
        constraints: (M,) expressions, stage by stage, the dynamics of a stage first.
        lower: (M,) lower bounds of the constraints.
        upper: (M,) upper bounds of the constraints.
    """

    variables: ca.SX
    parameters: ca.SX
    cost: ca.SX
    constraints: ca.SX
    lower: Floats
    upper: Floats


def lane_cost(y: ca.SX, centres: tuple[float, ...]) -> ca.SX:
    """Return the least sum of (s_i d_i)^2 over weights s_i >= 0 that sum to 1: 1 / sum(1 / d_i^2).

    Products instead of quotients define it on a lane's centre, too.
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
    """Build the programme of a plan of ``steps`` steps.

    Args:
        planner: Goals, weights and bounds.
        steps: H.
        dt: Step [s].
        y_bounds: Soft bounds of the lateral position [m].
        node_cost: Cost of node 0..H beyond the common terms.
        extra: Symbols of the parameters of ``node_cost``.
    """
    start = ca.SX.sym("start", STATES)
    smooth = isinstance(planner, MpcConfig) and planner.smooth_start
    nodes = [_node(k, k == steps) for k in range(steps + 1)]
    cost = ca.SX(0.0)
    rows: list[tuple[ca.SX, float, float]] = []
    for k, node in enumerate(nodes):
        cost += _common_cost(planner, node, free=k == 0 and not smooth) + node_cost(k, node)
        if k < steps:
            rows += [(defect, 0.0, 0.0) for defect in _defects(node, nodes[k + 1], dt)]
        if k == 0:
            rows += [(row, 0.0, 0.0) for row in ca.vertsplit(node.state - start)]
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


def _common_cost(planner: PlannerConfig, node: Node, free: bool) -> ca.SX:
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
    return cost if free else cost + change * (node.turn_rate - node.state[4]) ** 2


def _defects(node: Node, following: Node, dt: float) -> list[ca.SX]:
    x, y, speed, heading, _ = ca.vertsplit(node.state)
    reached = (  # unicycle, explicit Euler
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
    if not first:  # the first state is fixed
        rows.append((node.speed, planner.speed_min, planner.speed_max))
        rows.append((node.heading, -planner.heading_max, planner.heading_max))
    if not node.last:
        rows.append((node.acceleration, -planner.acceleration_max, planner.acceleration_max))
        rows.append((node.turn_rate, -planner.turn_rate_max, planner.turn_rate_max))
        if (lateral := planner.lateral_acceleration_max) is not None:
            rows.append((node.speed * node.turn_rate, -lateral, lateral))
        rows.append((node.slack, 0.0, np.inf))
        # bounding the next node here avoids inputs at the last one
        following = node.y + dt * node.speed * ca.sin(node.heading)
        rows.append((following - node.slack, -np.inf, y_bounds[1]))
        rows.append((following + node.slack, y_bounds[0], np.inf))
    return rows


def softplus(value: ca.SX, sharpness: float) -> ca.SX:
    """Return log(1 + exp(k u)) / k without overflow."""
    scaled = sharpness * value
    return (ca.fmax(scaled, 0.0) + ca.log1p(ca.exp(-ca.fabs(scaled)))) / sharpness


def build_problem(config: MpcConfig, scene: Scene) -> Nlp:
    """Build the programme; its parameters are in the order of ``pack_parameters``."""
    others, nodes = len(scene.names), config.horizon + 1
    x = ca.SX.sym("other_x", others, nodes)
    y = ca.SX.sym("other_y", others, nodes)
    half_lengths = ca.SX.sym("half_length", others)
    half_widths = ca.SX.sym("half_width", others)
    centres = lane_centres(config, scene)

    def cost(k: int, node: Node) -> ca.SX:
        total = config.lane_weight * lane_cost(node.y, centres)
        reach_x, reach_y = _clearance(config, scene, node)
        for i in range(others):
            missing_x = reach_x + half_lengths[i] - ca.fabs(node.state[0] - x[i, k])
            missing_y = reach_y + half_widths[i] - ca.fabs(node.y - y[i, k])
            # softplus increases, so its minimum over the axes is at the minimum of its argument
            missing = softplus(ca.fmin(missing_x, missing_y), config.sharpness)
            total += config.obstacle_weight * missing**2
        return total

    extra = ca.vertcat(ca.vec(x.T), ca.vec(y.T), half_lengths, half_widths)
    return build_nlp(config, config.horizon, scene.dt, lateral_bounds(config, scene), cost, extra)


def _clearance(config: MpcConfig, scene: Scene, node: Node) -> tuple[ca.SX, ca.SX]:
    dt = scene.dt
    lead = node.acceleration if config.lateral_lead == "acceleration" else node.speed
    along = (node.speed * dt + node.acceleration * dt**2) * ca.cos(node.heading)
    across = (node.speed * dt + lead * dt**2) * ca.sin(node.heading)
    return (
        config.clearance_ego_lengths * scene.ego_length + config.clearance_x + along,
        config.clearance_ego_widths * scene.ego_width + config.clearance_y + across,
    )


def pack_parameters(scene: Scene, start: Floats, other_x: Floats, other_y: Floats) -> Floats:
    """Return one row of parameters per particle.

    Args:
        scene: Sizes of the other vehicles.
        start: (N, 5) x, y, speed, heading now, and the last turn rate.
        other_x: (N, V, H + 1) predicted positions [m].
        other_y: (N, V, H + 1) predicted positions [m].
    """
    n = len(start)
    sizes = np.concatenate([scene.lengths, scene.widths]) / 2
    return np.concatenate(
        [start, other_x.reshape(n, -1), other_y.reshape(n, -1), np.broadcast_to(sizes, (n, len(sizes)))],
        axis=1,
    )
