"""Pictures without a display."""

from pathlib import Path

import numpy as np
import pytest
from highway_runs import run, simulator, tape
from PIL import Image

import avrare
from avrare.output.plots.rollout_plot import draw_run
from avrare_highway_env.render import frames, save_gif

SCENARIOS = Path(__file__).parents[3] / "scenarios"


def full(t, n):
    return np.tile([1.0, 0.0], (n, 1))


def test_a_gif(tmp_path, monkeypatch):
    monkeypatch.delenv("SDL_VIDEODRIVER", raising=False)
    sim = simulator(scene="merge", goal=50.0, start_seed=1)
    worlds = run(sim, tape(sim, 1, 10), full)
    pictures = frames(sim, worlds)
    over = int(np.argmax([world.over[0] for world in worlds]))
    assert len(pictures) == over + 1 < len(worlds)
    assert all(picture.mean() > 20.0 for picture in pictures)
    assert not np.array_equal(pictures[0], pictures[-1])
    path = tmp_path / "run.gif"
    save_gif(path, pictures, 0.1)
    with Image.open(path) as image:
        assert image.n_frames == len(pictures)
        assert image.info["duration"] == 100
        assert np.asarray(image.convert("RGB")).mean() > 20.0


@pytest.mark.parametrize("name", ["roundabout", "intersection"])
def test_drives_without_lanes_are_drawn_from_above(name, tmp_path):
    scenario = avrare.load(SCENARIOS / f"{name}.yaml", ["steps=6", "tracker.burn_in=0.3"])
    (picture,) = draw_run(scenario, [], tmp_path)
    assert picture.name == "nominal.png"
    pixels = np.asarray(Image.open(picture).convert("RGB"), dtype=int)
    asphalt = np.abs(pixels - (0xE8, 0xEB, 0xEE)).sum(axis=-1) < 4
    ego = np.abs(pixels - (0x1B, 0x6C, 0xA8)).sum(axis=-1) < 60
    assert asphalt.mean() > 0.03
    assert ego.sum() > 20
