"""Observations of the other vehicles, their errors in words, and the labels that trackers need."""

from __future__ import annotations

from typing import Any

import numpy as np

from avrare.base.errors import UsageError
from avrare.driving import Observation, Scene
from avrare.protocols import Floats, Misreading, PerceptionErrorModel, Tracker


def observe(
    perception: PerceptionErrorModel | None, world: Any, noise: Floats, latent: Any
) -> tuple[Observation, Any]:
    """Return the observation of a world, and the perception's memory after it; without a model the truth."""
    if perception is not None:
        return perception.follow(world, noise, latent)
    others = world.others
    detected = np.ones(others.x.shape, dtype=bool)
    along, across = (others.speed * part(others.heading) for part in (np.cos, np.sin))
    return Observation(detected, others.x, others.y, along, across, others.heading), None


_DIRECTIONS = {
    "longitudinal error": ("{} m too far ahead", "{} m too far behind", 0.1),
    "lateral error": ("{} m too far left", "{} m too far right", 0.1),
    "speed error": ("{} m/s too fast", "{} m/s too slow", 0.3),
}
"""Words for positive and negative errors, and the smallest ones that are worth them."""


def find_misreadings(
    perception: PerceptionErrorModel, world: Any, observation: Observation, scene: Scene
) -> dict[str, Misreading]:
    """Return the errors of an observation, against the observation of the same world without noise.

    They are named as the noise of a perception model should be: "detection of van", whose error is NaN where
    the van is missed, "longitudinal error of van", "lateral error of van" and "speed error of van".
    """
    neutral = perception.observe(world, np.zeros((len(observation.x), perception.noise_size)))
    errors, usual = (_compute_errors(world, seen) for seen in (observation, neutral))
    names = [*scene.names, *(f"ghost {k + 1}" for k in range(observation.x.shape[1] - len(scene.names)))]
    misreadings = {}
    for v, name in enumerate(names):
        subject = f"car {name}" if name.isdecimal() else name
        seen = (np.where(each.detected[:, v], 0.0, np.nan) for each in (observation, neutral))
        values, expected = seen
        misreadings[f"detection of {name}"] = Misreading(values, subject, "", "", expected)
        for axis, (error, (above, below, least)) in enumerate(_DIRECTIONS.items()):
            if v < len(scene.names):
                misreadings[f"{error} of {name}"] = Misreading(
                    errors[axis, :, v], subject, above, below, usual[axis, :, v], least
                )
    return misreadings


def _compute_errors(world: Any, observation: Observation) -> Floats:
    """Return (3, N, V) errors of the positions along and across the road and of the speed."""
    others = world.others
    x, y, speed_x = (
        part[:, : others.x.shape[1]] for part in (observation.x, observation.y, observation.speed_x)
    )
    return np.stack([x - others.x, y - others.y, speed_x - others.speed * np.cos(others.heading)])


def check_labels(perception: PerceptionErrorModel, tracker: Tracker) -> None:
    """Raise UsageError where the tracker needs labels that false detections do not have."""
    if perception.ghost_slots and tracker.known_scene is None:
        raise UsageError(
            "it needs to know the vehicle of each detection, but the perception reports false detections "
            "(`ghosts`), which are of none",
            "let the tracker find out: tracker: {plugin: imm, association: hungarian, gate: 4, death: 10}",
        )
