"""Simulator: an OpenSCENARIO file, one of its vehicles as the ego and its storyboard as the traffic."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from avrare.base.errors import UsageError
from avrare.driving import Scene, World
from avrare.protocols import Bools, Floats
from avrare_openscenario.acted_traffic import ActedTraffic
from avrare_openscenario.conditions import StoryMemory
from avrare_openscenario.config import OpenScenarioConfig
from avrare_openscenario.scenario_file import Body, ScenarioFile, read_scenario
from avrare_openscenario.starts import speed_all
from avrare_openscenario.story import Assignment
from avrare_single_track.config import EgoConfig, SingleTrackConfig
from avrare_single_track.file_config import check_ego
from avrare_single_track.simulator import SingleTrack, TrackWorld

PREFIX = "parameters."
"""Beginning of the place of a drawn parameter."""


def build(config: OpenScenarioConfig, scene: Scene | None = None) -> OpenScenario:
    """Build the simulator of a scenario.

    Raises:
        UsageError: Something in the file is not understood.
    """
    return OpenScenario(config)


@dataclass(frozen=True)
class StoryWorld(TrackWorld):
    """State of the simulator.

    Attributes:
        story: State of the storyboard.
    """

    story: StoryMemory | None = None


class OpenScenario(SingleTrack):
    """Single-track ego among vehicles that act out a storyboard."""

    def __init__(self, config: OpenScenarioConfig) -> None:
        self.options = config
        self.file = file = read_scenario(
            str(config.file),
            config.entity,
            config.dt,
            config.parameters,
            None if config.road is None else str(config.road),
            config.ignore_ego_events,
            [str(path) for path in config.catalogs],
        )
        *others, ego = file.bodies
        ego_config = _build_ego(config, file, ego)
        super().__init__(SingleTrackConfig(dt=config.dt, ego=ego_config, after_impact=config.after_impact))
        self.acted = ActedTraffic(file, config.dt)
        driven = {action.actor for action in file.story.actions if not isinstance(action, Assignment)}
        speeds = speed_all(file.story, file.parameters.table({}, 1))[0]
        self.scene = Scene(
            config.dt,
            file.maps[-1].road,
            self.config.ego.length,
            self.config.ego.width,
            tuple(body.name for body in others),
            np.array([body.length for body in others]),
            np.array([body.width for body in others]),
            np.array([speeds[k] != 0.0 or k in driven for k in range(len(others))], dtype=bool),
        )
        self.acted.check_start()

    def drawing(self, laws: Mapping[str, object]) -> OpenScenario:
        """Return the simulator itself: every rollout has its own numbers anyway.

        Raises:
            UsageError: A parameter is drawn that decides what the file means, such as a lane.
        """
        drawn = {path.removeprefix(PREFIX) for path in laws}
        if wrong := sorted(drawn & self.file.parameters.decisive):
            text = f"{self.file.path}: the parameter {wrong[0]!r} is drawn, but it names a lane or a thing"
            raise UsageError(text, "only numbers can be drawn")
        return self

    def reset(self, noise: Floats) -> StoryWorld:
        """Return the worlds at the file's start."""
        return self.reset_drawn(noise, {})

    def reset_drawn(self, noise: Floats, values: Mapping[str, Floats]) -> StoryWorld:
        """Return the worlds at the start with drawn parameters (N,)."""
        parameters = {path.removeprefix(PREFIX): values[path] for path in values if path.startswith(PREFIX)}
        world = super().reset(noise)
        ego, story = self.acted.start(len(noise), parameters)
        fields = {**vars(world), "ego": ego, "others": self.acted.show(story)}
        if (weather := values.get("weather")) is not None:
            fields["weather"] = weather
        return StoryWorld(**fields, story=story)

    def _move_others(self, world: TrackWorld, noise: Floats) -> dict[str, Any]:
        assert isinstance(world, StoryWorld)
        assert world.story is not None
        story = self.acted.step(world.story, world.step, world.ego)
        return {"others": self.acted.show(story), "story": story}

    def impossible(self, world: StoryWorld) -> Bools:
        """Return (N,) True where a ``ConstraintGroup`` forbids the drawn parameters."""
        assert world.story is not None
        return np.asarray(np.isnan(world.story.table).all(axis=1))

    def faults(self, world: World) -> Bools:
        """Return (N,) True where the state of a vehicle or a number of the file is not finite."""
        lost = ~(np.isfinite(world.others.x) & np.isfinite(world.others.y) & np.isfinite(world.others.speed))
        assert isinstance(world, StoryWorld)
        assert world.story is not None
        wrong = ~np.isfinite(world.story.table).all(axis=1)
        return super().faults(world) | lost.any(axis=1) | wrong


def _build_ego(config: OpenScenarioConfig, file: ScenarioFile, body: Body) -> EgoConfig:
    options: dict[str, Any] = {"length": body.length, "width": body.width}
    options |= {} if body.wheelbase is None else {"wheelbase": body.wheelbase}
    options |= {} if body.speed_max is None else {"speed_max": body.speed_max}
    speed = float(speed_all(file.story, file.parameters.table({}, 1))[0, -1])
    options |= {"x": 0.0, "y": 0.0, "heading": 0.0, "speed": abs(speed)}
    if wrong := sorted(set(options) & set(config.ego)):
        hint = "set a parameter of the file in `parameters`, or change the file"
        raise UsageError(f"ego.{wrong[0]}: that of the ego is given by {file.path}", hint)
    return check_ego(file.path, {**options, **config.ego})
