"""With MetaDrive itself, in an environment that has it: what a run is depends on its noise alone."""

import hashlib
from importlib.util import find_spec

import numpy as np
import pytest

from avrare_metadrive import expert
from avrare_metadrive.config import SIGNALS, ExpertConfig, MetaDriveConfig
from avrare_metadrive.process import RootProcess
from avrare_metadrive.world import ENGINE, MetaDriveWorld, build

pytestmark = pytest.mark.skipif(find_spec("metadrive") is None, reason="MetaDrive is not installed")

NOISE = {"variance": 0.004}


@pytest.fixture(scope="module")
def driver():
    return expert.build(ExpertConfig())


def drive(world, driver, tape):
    """Return what there is to read at every step."""
    world.reset(tape[0])
    found = [world.numbers()]
    for row in tape[1:]:
        action, _ = driver.act(None, world.observation()[None], None)
        world.step(action[0], row)
        found.append(world.numbers())
    return np.array(found)


def tape(steps, seed=0):
    return np.random.default_rng(seed).standard_normal((steps + 1, 240))


def test_the_same_noise_gives_the_same_run_in_two_processes_and_after_a_reset(driver):
    config = MetaDriveConfig(start_seed=4, noise=NOISE)
    noise = tape(60)
    first = drive(MetaDriveWorld(config), driver, noise)
    assert first[-1, SIGNALS.index("speed")] > 5.0
    assert (first[:, 50:] >= 0.0).all()
    again = MetaDriveWorld(config)
    assert not np.array_equal(drive(again, driver, tape(60, 1)), first)
    assert np.array_equal(drive(again, driver, noise), first)
    fresh = RootProcess(ENGINE)  # another Python, and its car goes back by MetaDrive's own reset
    fresh.call("begin", config)
    for _ in range(20):
        fresh.call("step", 0.1, 1.0)
    assert np.array_equal(fresh.call("reset")[: len(SIGNALS)], first[0, : len(SIGNALS)])
    for row in first[:-1]:
        action, _ = driver.act(None, row[None, len(SIGNALS) :], None)
        numbers = fresh.call("step", *action[0].tolist())
    assert np.array_equal(numbers[: len(SIGNALS)], first[-1, : len(SIGNALS)])


@pytest.mark.parametrize("copy", ["fork", "replay"])
def test_rows_are_independent_and_branch(driver, copy):
    simulator = build(MetaDriveConfig(start_seed=4, noise=NOISE, copy=copy))
    noise = np.stack([tape(30, seed) for seed in range(3)])

    def on(world, rows, start):
        for t in range(start, 31):
            action, _ = driver.act(None, world.seen, None)
            world = simulator.step(world, action, noise[rows, t])
        return world

    def middle(rows):
        world = simulator.reset(noise[rows, 0])
        for t in range(1, 12):
            action, _ = driver.act(None, world.seen, None)
            world = simulator.step(world, action, noise[rows, t])
        return world

    half = middle([0, 1, 2])
    whole = on(half, [0, 1, 2], 12)
    assert np.array_equal(on(half, [0, 1, 2], 12).seen, whole.seen)
    assert np.array_equal(on(middle([1]), [1], 12).seen[0], whole.seen[1])


def test_the_expert_is_what_metadrive_computes(driver):
    path = expert.locate()
    assert hashlib.sha256(path.read_bytes()).hexdigest() == expert.PROVENANCE["sha256"]
    seen = drive(MetaDriveWorld(MetaDriveConfig()), driver, np.zeros((40, 0)))[:, len(SIGNALS) :]
    turned = seen.astype(np.float32)
    turned[:, [15, 10]] = 1.0 - turned[:, [15, 10]]
    with np.load(path, allow_pickle=False) as file:
        values = turned
        for name in ("fc_1", "fc_2", "fc_out"):
            values = (
                np.matmul(values, file[f"default_policy/{name}/kernel"]) + file[f"default_policy/{name}/bias"]
            )
            values = values if name == "fc_out" else np.tanh(values)
    expected = np.clip(values[:, :2], -1.0, 1.0)
    found, _ = driver.act(None, seen, None)
    np.testing.assert_allclose(found, expected, atol=1e-4)
    assert expected.std(axis=0).max() > 0.05


def test_signals_and_a_picture(driver):
    world = MetaDriveWorld(MetaDriveConfig(start_seed=4))
    found = drive(world, driver, np.zeros((31, 0)))
    signals = dict(zip(SIGNALS, found.T, strict=False))
    distance = np.hypot(np.diff(signals["x"]), np.diff(signals["y"]))
    np.testing.assert_allclose(distance[-5:], 0.1 * signals["speed"][-5:], rtol=0.05)  # m/s, steps of 0.1 s
    gone = signals["remaining"][0] - signals["remaining"][-1]
    assert gone == pytest.approx(distance.sum(), rel=0.05)
    assert signals["completion"][-1] > signals["completion"][0]
    assert 0.0 < signals["nearest"].min() <= 50.0
    assert not signals["over"].any()
    picture = world.picture(200, 100)
    assert picture.shape == (100, 200, 3)
    assert 20.0 < picture.mean() < 254.9
    assert picture.std() > 1.0


def test_full_throttle_ends_off_the_road_or_in_a_crash_and_stands_still(driver):
    world = MetaDriveWorld(MetaDriveConfig(start_seed=4))
    world.reset(np.zeros(0))
    for _ in range(60):
        world.step(np.array([0.3, 1.0]), np.zeros(0))
    signals = world.signals()
    assert signals["over"] == 1.0
    assert signals["off_road"] + signals["crashed"] > 0.0
    assert signals["arrived"] == 0.0
    before = world.numbers().copy()
    world.step(np.array([0.0, 1.0]), np.zeros(0))
    assert np.array_equal(world.numbers(), before)
