"""End of a drive at the ego's first contact with another vehicle."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from avrare.base import batch
from avrare.driving import Scene
from avrare.driving.geometry import (
    ego_rectangle,
    find_contacts,
    interpolate,
    other_rectangles,
    signed_distance,
)

if TYPE_CHECKING:
    from avrare_single_track.simulator import TrackWorld


def end_at_impact(scene: Scene, before: TrackWorld, after: TrackWorld) -> TrackWorld:
    """Return the next worlds: those in which the ego touches a vehicle end, and ended ones do not change.

    Vehicles that touch within a step and are apart after it stay where they touch first.
    """
    contacts = find_contacts(scene, (before.ego, before.others), (after.ego, after.others))
    share = contacts.min(axis=1, initial=np.inf)
    hit = np.isfinite(share)
    if hit.any():
        distance = signed_distance(ego_rectangle(after.ego, scene), other_rectangles(after.others, scene))
        at = np.where(hit & (distance > 0.0).all(axis=1), share, 1.0)
        passed = at < 1.0
        touching = replace(
            after,
            ego=interpolate(before.ego, after.ego, at),
            others=interpolate(before.others, after.others, at[:, None]),
        )
        after = batch.choose(passed, touching, after)
    after = replace(after, ended=hit)
    return (
        after if before.ended is None or not before.ended.any() else batch.choose(before.ended, before, after)
    )
