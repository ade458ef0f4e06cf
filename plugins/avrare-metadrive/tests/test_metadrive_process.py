"""Processes and their copies, with things that need no MetaDrive."""

import gc
import os
import time

import numpy as np
import pytest

from avrare.base.errors import UsageError
from avrare.worlds.worlds_simulator import Worlds
from avrare_metadrive import world
from avrare_metadrive.config import MetaDriveConfig
from avrare_metadrive.process import RootProcess
from avrare_metadrive.world import MetaDriveWorld

STEPS = 5


@pytest.fixture
def counter(helpers):
    return RootProcess("metadrive_counter")


def test_a_copy_continues_from_the_state_of_the_original(counter):
    assert counter.call("add", 3) == 3
    copy = counter.fork()
    assert counter.call("add", 10) == 13
    twin = copy.fork()
    assert copy.call("add", 1) == 4
    assert twin.call("add", 2) == 5
    assert len({one.call("own") for one in (counter, copy, twin)}) == 3


def test_an_exception_in_the_process_is_raised_in_the_caller(counter):
    with pytest.raises(RuntimeError, match="TypeError"):
        counter.call("add", "three")
    assert counter.call("add", 1) == 1


def test_a_process_that_dies_is_an_error(counter):
    copy = counter.fork()
    for name in ("die", "add"):
        with pytest.raises(RuntimeError, match=f"has ended in {name}"):
            copy.call(name, *[1][: name == "add"])
    with pytest.raises(RuntimeError, match="has ended in fork"):
        copy.fork()
    assert counter.call("add", 1) == 1


def test_processes_end_with_their_owners(counter):
    copy = counter.fork()
    one, two = counter.call("own"), copy.call("own")
    del copy
    gc.collect()
    assert _gone(two)
    assert not _gone(one, seconds=0.0)


def _gone(process, seconds=20.0):
    for _ in range(int(50 * seconds) + 1):
        try:
            os.kill(process, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.02)
    return False


@pytest.fixture
def make(helpers, monkeypatch):
    monkeypatch.setattr(world, "ENGINE", "metadrive_fake")
    world._roots.clear()
    config = MetaDriveConfig(lasers=12, noise={"variance": 0.004})
    yield lambda: MetaDriveWorld(config)
    world._roots.clear()


def _tape(n):
    return np.random.default_rng(5).standard_normal((n, STEPS + 1, 12))


def _run(worlds, tape, state=None, start=0, throttle=None):
    """Return all states; the action follows from what is seen."""
    states = [worlds.reset(tape[:, 0]) if state is None else state]
    for t in range(start + 1, STEPS + 1):
        action = np.clip(states[-1].seen[:, -2:] - 0.5, -0.5, 0.5)
        states.append(worlds.step(states[-1], action, tape[:, t]))
    return states


@pytest.mark.parametrize("copy", ["hook", "replay"])
def test_rows_and_branches_are_independent(make, copy):
    worlds, tape = Worlds(make, copy=copy), _tape(4)
    states = _run(worlds, tape)
    alone = _run(Worlds(make, copy=copy), tape[2:3])
    for together, single in zip(states, alone, strict=True):
        assert np.array_equal(together.seen[2:3], single.seen)
        assert together.signals["x"][2] == single.signals["x"][0]
    again = _run(worlds, tape, states[2], 2)
    assert np.array_equal(again[-1].seen, states[-1].seen)
    assert len(set(states[-1].signals["x"])) == 4


def test_the_driver_sees_noise_on_the_rays_alone(make):
    one, tape = make(), _tape(1)[0]
    one.reset(tape[0])
    true = 0.5 + 0.5 * np.sin(np.arange(12))
    seen = one.observation()
    assert (seen[:35] == 0.0).all()
    assert (seen[35:] != true).all()
    assert np.array_equal(seen[35:], world.disturb(true, tape[0], np.sqrt(0.004)))
    again = make()
    again.reset(tape[1])
    assert (again.observation()[35:] != seen[35:]).all()


def test_errors_in_a_world(make):
    one, tape = make(), _tape(1)[0]
    one.reset(tape[0])
    with pytest.raises(RuntimeError, match="the steering wheel comes off"):
        one.step(np.array([1.0, 0.0]), tape[1])
    for actions in (None, np.zeros((1, 3)), np.zeros(2)):
        with pytest.raises(UsageError, match="steering and throttle"):
            one.prepare(actions, tape[:1])
    with pytest.raises(UsageError, match="not been reset"):
        make().snapshot()
