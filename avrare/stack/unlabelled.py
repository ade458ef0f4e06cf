"""Observations without labels: false detections, and trackers that find out what a detection is of."""

from __future__ import annotations

from typing import Any, Protocol

from avrare.base.errors import UsageError
from avrare.driving import Scene
from avrare.protocols import find_ability


class ReportsGhosts(Protocol):
    """Perception error model whose observations have slots for false detections, after the vehicles' ones."""

    ghost_slots: int


class AssociatesDetections(Protocol):
    """Tracker that finds out itself which detection belongs to which track.

    It may have more tracks than there are vehicles: a controller is built for ``known_scene``, and told of
    all of them.
    """

    known_scene: Scene
    """The scene with a vehicle for each track: those of the simulator, then others."""


def scene_of_tracks(tracker: Any, scene: Scene | None) -> Scene | None:
    """Return the scene that a controller behind ``tracker`` is built for."""
    associating = find_ability(tracker, AssociatesDetections)
    return scene if associating is None else associating.known_scene


def check_labels(perception: Any, tracker: Any) -> None:
    """Raise UsageError where the tracker needs labels that false detections do not have."""
    ghosts = find_ability(perception, ReportsGhosts)
    if ghosts is not None and ghosts.ghost_slots and find_ability(tracker, AssociatesDetections) is None:
        raise UsageError(
            "it is told which vehicle each detection is of, but the perception reports false detections "
            "(`ghosts`), which are of none",
            "let the tracker find out: tracker: {plugin: imm, association: hungarian, gate: 4, death: 10}",
        )
