"""Observations without labels: false detections, and trackers that find out the vehicle of a detection."""

from __future__ import annotations

from avrare.base.errors import UsageError
from avrare.protocols import PerceptionErrorModel, Tracker


def check_labels(perception: PerceptionErrorModel, tracker: Tracker) -> None:
    """Raise UsageError where the tracker needs labels that false detections do not have."""
    if perception.ghost_slots and tracker.known_scene is None:
        raise UsageError(
            "it needs to know the vehicle of each detection, but the perception reports false detections "
            "(`ghosts`), which are of none",
            "let the tracker find out: tracker: {plugin: imm, association: hungarian, gate: 4, death: 10}",
        )
