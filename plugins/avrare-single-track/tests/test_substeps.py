"""Integration in parts of a step: noise, schedules and actions keep the step, motions converge."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from avrare.driving import Action
from avrare_single_track.config import SingleTrackConfig
from avrare_single_track.simulator import SingleTrack
from drivers import car

CROWD = [
    car("slow", 60.0, speed=10.0, desired=11.0, acceleration_sd=0.3),
    car("fast", 0.0, speed=22.0, acceleration_sd=0.3, reaction_time=0.4, reaction_sd=0.2),
    {"name": "script", "x": 20.0, "y": 5.25, "speed": 15.0},
    car("braking", 90.0, speed=20.0, brake=[{"from_step": 5, "to_step": 14, "acceleration": -3.0}]),
]
EGO = {"x": -60.0, "y": 1.75, "speed": 20.0}


def drive(substeps, steps=40, n=4):
    config = {"ego": EGO, "vehicles": CROWD, "substeps": substeps}
    sim = SingleTrack(SingleTrackConfig.model_validate(config))
    noise = np.random.default_rng(5).standard_normal((steps + 1, n, sim.noise_size))
    worlds = [sim.reset(noise[0])]
    for k, row in enumerate(noise[1:]):
        action = Action(np.full(n, -0.5), np.full(n, 0.02 * np.sin(0.3 * k)))
        worlds.append(sim.step(worlds[-1], action, row))
    return worlds


def place(worlds, name):
    return np.stack([np.column_stack([getattr(w.others, name), getattr(w.ego, name)]) for w in worlds])


def test_motions_converge_and_the_mood_is_the_same():
    one, two, four, eight = (drive(count) for count in (1, 2, 4, 8))
    for name in ("x", "speed"):
        values = [place(worlds, name) for worlds in (one, two, four, eight)]
        changes = [np.abs(a - b).max() for a, b in pairwise(values)]
        assert changes[0] > changes[1] > changes[2] > 0.0
        assert changes[0] < 0.6
    np.testing.assert_array_equal(one[-1].drivers.mood, eight[-1].drivers.mood)
    np.testing.assert_array_equal(one[-1].drivers.haste, eight[-1].drivers.haste)


def test_schedules_and_accelerations_are_those_of_whole_steps():
    worlds = drive(4)
    speed, acceleration = place(worlds, "speed"), place(worlds, "acceleration")
    np.testing.assert_allclose(np.diff(speed, axis=0) / 0.1, acceleration[1:], atol=1e-9)
    braking = acceleration[1:, :, 3]
    assert (braking[5:15] <= -2.999).all()
    assert (braking[15:20] > -2.9).all()
    np.testing.assert_array_equal(place(worlds, "x")[:, :, 2], place(drive(1), "x")[:, :, 2])


def test_a_heading_turns_the_short_way_within_a_step(monkeypatch):
    sim = SingleTrack(SingleTrackConfig.model_validate({"ego": EGO, "vehicles": CROWD, "substeps": 2}))
    start, seen, move = sim.reset(np.zeros((1, sim.noise_size))), [], sim.reactive.move
    before, after = (replace(start.others, heading=np.full((1, 4), heading)) for heading in (3.1, -3.1))

    def move_and_note(memory, step, ego, others):
        seen.append(others.heading[0, 2])
        return move(memory, step, ego, others)

    monkeypatch.setattr(sim.reactive, "move", move_and_note)
    monkeypatch.setattr(sim, "_others", lambda step, plans: after)
    sim.step(replace(start, others=before), Action(np.zeros(1), np.zeros(1)), np.zeros((1, sim.noise_size)))
    assert seen == pytest.approx([3.1, np.pi])
