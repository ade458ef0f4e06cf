"""Values of driving that simulators, perception, trackers, controllers and rules share."""

from avrare.driving.values import Action, Observation, Prediction, Road, Scene, Vehicles, World

__all__ = ["Action", "Observation", "Prediction", "Road", "Scene", "Vehicles", "World"]
