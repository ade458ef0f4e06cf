"""Observations of the other vehicles, with the errors of a perception model or without any."""

from __future__ import annotations

from typing import Any

import numpy as np

from avrare.driving import Observation
from avrare.protocols import Floats, PerceptionErrorModel


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
