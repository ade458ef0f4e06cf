"""Values of driving that simulators, perception, trackers, controllers and rules share."""

from avrare.driving.values import (
    Action,
    Crossing,
    Lane,
    Observation,
    ObservingEgo,
    Prediction,
    Road,
    Scene,
    Vehicles,
    World,
)

__all__ = [
    "Action",
    "Crossing",
    "Lane",
    "Observation",
    "ObservingEgo",
    "Prediction",
    "Road",
    "Scene",
    "Vehicles",
    "World",
]
