"""The controller's optimal control problem: the common terms plus lanes and clearances to the others."""

from __future__ import annotations

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from avrare.driving import Scene
from avrare_mpc.config import MpcConfig
from avrare_mpc.lanes import lane_centres, lateral_bounds
from avrare_mpc.nlp import Nlp, Node, build_nlp, lane_cost

Floats = NDArray[np.float64]


def softplus(value: ca.SX, sharpness: float) -> ca.SX:
    """log(1 + exp(k u)) / k without overflow."""
    scaled = sharpness * value
    return (ca.fmax(scaled, 0.0) + ca.log1p(ca.exp(-ca.fabs(scaled)))) / sharpness


def build_problem(config: MpcConfig, scene: Scene) -> Nlp:
    """The programme with parameters as ``pack_parameters`` lays them out."""
    others, nodes = len(scene.names), config.horizon + 1
    x = ca.SX.sym("other_x", others, nodes)
    y = ca.SX.sym("other_y", others, nodes)
    half_lengths = ca.SX.sym("half_length", others)
    half_widths = ca.SX.sym("half_width", others)
    centres = lane_centres(config, scene)

    def cost(k: int, node: Node) -> ca.SX:
        total = config.lane_weight * lane_cost(node.y, centres)
        reach_x, reach_y = _reach(config, scene, node)
        for i in range(others):
            missing_x = reach_x + half_lengths[i] - ca.fabs(node.state[0] - x[i, k])
            missing_y = reach_y + half_widths[i] - ca.fabs(node.y - y[i, k])
            # softplus is increasing: its minimum over the axes is that of its argument
            missing = softplus(ca.fmin(missing_x, missing_y), config.sharpness)
            total += config.obstacle_weight * missing**2
        return total

    extra = ca.vertcat(ca.vec(x.T), ca.vec(y.T), half_lengths, half_widths)
    return build_nlp(config, config.horizon, scene.dt, lateral_bounds(config, scene), cost, extra)


def _reach(config: MpcConfig, scene: Scene, node: Node) -> tuple[ca.SX, ca.SX]:
    """Wanted distance between the centres, less half the other's size, along and across the road [m]."""
    dt = scene.dt
    lead = node.acceleration if config.lateral_lead == "acceleration" else node.speed
    along = (node.speed * dt + node.acceleration * dt**2) * ca.cos(node.heading)
    across = (node.speed * dt + lead * dt**2) * ca.sin(node.heading)
    return (
        config.clearance_ego_lengths * scene.ego_length + config.clearance_x + along,
        config.clearance_ego_widths * scene.ego_width + config.clearance_y + across,
    )


def pack_parameters(scene: Scene, start: Floats, other_x: Floats, other_y: Floats) -> Floats:
    """One row of parameters for each particle.

    Args:
        scene: Sizes of the others.
        start: (N, 4) x, y, speed, heading now.
        other_x: (N, V, H + 1) predicted positions [m].
        other_y: (N, V, H + 1) predicted positions [m].
    """
    n = len(start)
    sizes = np.concatenate([scene.lengths, scene.widths]) / 2
    return np.concatenate(
        [start, other_x.reshape(n, -1), other_y.reshape(n, -1), np.broadcast_to(sizes, (n, len(sizes)))],
        axis=1,
    )
