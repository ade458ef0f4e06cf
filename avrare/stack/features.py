"""Features: numbers that tell how a rollout may go on, for estimators that learn it.

A part declares its features (its method ``features``). Where it declares none, a closed loop offers
those of every driving stack: positions and speeds, the tracker's errors, the plan. Any
other system offers its signals.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from avrare.base.errors import UsageError
from avrare.driving import Prediction
from avrare.protocols import Floats, Signals, Specification, System


def system_features(system: System, state: object) -> Floats:
    """Return the features (N, F) that a system declares, else its signals."""
    declared = system.features(state)
    return flatten(system.signals(state)) if declared is None else check_features(system, declared)


def check_features(part: object, values: object) -> Floats:
    """Return declared features as floats (N, F); a ``UsageError`` for another shape."""
    features = np.asarray(values, dtype=np.float64)
    if features.ndim != 2:
        text = f"features of {type(part).__name__} have shape {features.shape}, not (N, F)"
        raise UsageError(text, "return a NumPy array with one row a particle, or leave `features` out")
    return features


def monitor_features(
    specification: Specification, state: object, robustness: Floats, score: Floats
) -> Floats:
    """Return (N, 3) margin at the newest sample, robustness and score so far; the score is the last."""
    margin = specification.margin(state)
    return np.stack([robustness if margin is None else margin, robustness, score], axis=1)


def flatten(signals: Signals) -> Floats:
    """Return all numbers of named arrays as columns (N, F)."""
    columns = [np.asarray(x, dtype=np.float64).reshape(len(x), -1) for x in signals.values()]
    return np.concatenate(columns, axis=1)


def vehicle_features(world: Any) -> Floats:
    """Return positions, speeds and headings (N, F) of a driving world, the others relative to the ego."""
    ego, others = world.ego, world.others
    ego_columns = [ego.x, ego.y, ego.speed, ego.heading, ego.acceleration]
    relative = [others.x - ego.x[:, None], others.y - ego.y[:, None], others.speed, others.heading]
    return np.concatenate([np.stack(ego_columns, axis=1), *relative], axis=1)


def track_features(tracker: Any, track: Any, world: Any) -> Floats | None:
    """Return (N, F) the errors of tracked positions and steps; 0 and a mark where a vehicle has no track.

    None where the tracker does not predict vehicles.
    """
    others, predicted = world.others, tracker.predict(track, 1)
    if not isinstance(predicted, Prediction):
        return None
    tracked = np.isfinite(predicted.x[..., 0])
    with np.errstate(invalid="ignore"):  # what is not tracked is infinitely far away
        errors = [
            predicted.x[..., 0] - others.x,
            predicted.y[..., 0] - others.y,
            predicted.x[..., 1] - predicted.x[..., 0],
            predicted.y[..., 1] - predicted.y[..., 0],
        ]
    columns = [np.where(tracked, error, 0.0) for error in errors]
    return np.concatenate([tracked.astype(np.float64), *columns], axis=1)


def plan_features(states: Floats | None) -> Floats | None:
    """Return (N, F) some nodes of a controller's plan relative to its first one; None without a plan."""
    if states is None or np.ndim(states) != 3:
        return None
    nodes = [node for node in (1, 3, 6, 10, 15, 20) if node < states.shape[1]]
    return np.asarray((states[:, nodes] - states[:, :1]).reshape(len(states), -1))
