"""Pictures without a display."""

import numpy as np
import pytest
from highway_runs import run, simulator, tape
from PIL import Image

from avrare.base.errors import UsageError
from avrare_highway_env.render import frames, save_gif


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


def test_pictures_do_not_change_the_simulator(monkeypatch):
    monkeypatch.delenv("SDL_VIDEODRIVER", raising=False)
    sim, other = (simulator(scene="highway", vehicles=3) for _ in range(2))
    noise = tape(sim, 2, 8)
    worlds = run(sim, noise, full)
    frames(sim, worlds, row=1)
    again = run(sim, noise, full, world=worlds[4], start=4)[-1]
    assert np.array_equal(again.others.x, run(other, noise, full)[-1].others.x)


def test_the_driver_that_draws_nothing_is_refused(monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    sim = simulator(scene="merge", start_seed=1)
    with pytest.raises(UsageError, match="black"):
        frames(sim, [sim.reset(np.zeros((1, 0)))])
