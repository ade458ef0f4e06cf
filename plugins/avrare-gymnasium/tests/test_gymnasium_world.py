"""Environments as worlds: stock ones, and odd ones that are registered here."""

import random
import time

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces

import avrare
from avrare.base.errors import AvrareError, UsageError
from avrare.rollout.noise import NoiseSource
from avrare.stack.closed_loop import ClosedLoop
from avrare.worlds import capabilities
from avrare_gymnasium.config import GymnasiumConfig
from avrare_gymnasium.controllers import Constant, Feedback
from avrare_gymnasium.world import build

POLE = {"env": "CartPole-v1", "signals": {"x": 0, "angle": 2}}
TAPE = {"stream": {"by": "tape", "at": "reset", "numbers": 4}, "action": {"scale": 1.5}}
LIMIT, STEPS = 2.0, 12


class Odd(gymnasium.Env):
    """A walk that does what its kind says where it comes beyond the limit."""

    observation_space = spaces.Box(-np.inf, np.inf, (1,))
    action_space = spaces.Box(-1.0, 1.0, (1,))

    def __init__(self, kind="calm"):
        self.kind = kind
        if kind == "longer":
            self.observation_space = spaces.Box(-np.inf, np.inf, (2,))

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.x = 0.0
        if self.kind == "stillborn":
            raise OSError("no display")
        return np.array([self.x]), {}

    def step(self, action):
        action *= 1.0  # writes to what it is handed
        self.x += self.np_random.normal()
        if self.kind == "careless":
            self.x += 1e-3 * random.random()
        if self.x > LIMIT:
            self.break_down()
        return np.array([self.x]), -self.x, False, False, {}

    def break_down(self):
        if self.kind == "raising":
            raise ValueError("beyond the limit")
        if self.kind == "missing":
            self.x = np.nan
        while self.kind == "hanging":
            time.sleep(0.01)

    def snapshot(self):
        return self.x, self.np_random.bit_generator.state

    def restore(self, snapshot):
        self.x, self.np_random.bit_generator.state = snapshot


@pytest.fixture(scope="module", autouse=True)
def _registered():
    gymnasium.register("Odd-v0", Odd, max_episode_steps=8)
    yield
    gymnasium.registry.pop("Odd-v0")


def loop(controller=None, **options):
    return ClosedLoop(build(GymnasiumConfig(**options)), controller=controller)


def pole(**options):
    return loop(Feedback([[-0.1, -0.2, -10.0, -2.0]]), **POLE, noise=TAPE, **options)


def odd(kind="calm", **options):
    settings = {"env": "Odd-v0", "options": {"kind": kind}, "signals": {"x": 0}} | options
    return loop(Constant((0.0,)), **settings)


def tape(system, n, steps=STEPS, seed=0):
    return NoiseSource(seed, system.noise_size).normals(0, 0, np.arange(n)[:, None], np.arange(steps + 1))


def course(system, noise, state=None, since=0):
    state = system.initial(noise[:, 0]) if state is None else state
    found = [system.signals(state)]
    for t in range(since + 1, noise.shape[1]):
        state = system.step(state, noise[:, t])
        found.append(system.signals(state))
    return {name: np.stack([one[name] for one in found], axis=1) for name in found[0]}, state


def check_restored(system, noise, whole):
    """Restore twice in the middle, other rollouts having been there: the course is that of the whole."""
    _, middle = course(system, noise[:, :6])
    for _ in range(2):
        course(system, tape(system, 4, seed=9), middle, 5)
        again, _ = course(system, noise, middle, 5)
        for name, values in again.items():  # a time limit among them
            np.testing.assert_array_equal(values, whole[name][:, 5:])


def test_the_simulator_equals_the_bare_environment():
    system = loop(Constant(1), env="CartPole-v1", noise={"stream": {"by": "none"}})
    found, _ = course(system, np.zeros((1, STEPS + 1, 0)))
    env = gymnasium.make("CartPole-v1")
    observation, _ = env.reset(seed=0)
    for t in range(STEPS + 1):
        assert [found[f"o{i}"][0, t] for i in range(4)] == observation.tolist()
        observation, reward, terminated, _, _ = env.step(1)
        if terminated:
            break
    assert t < STEPS
    assert (reward, found["terminated"][0, t + 1]) == (1.0, 1.0)


def test_an_ended_environment_stands_still():
    system = loop(Constant(1), env="CartPole-v1")
    found, _ = course(system, tape(system, 5, 30))
    for row in range(5):
        end = int(np.argmax(found["terminated"][row]))
        assert 5 < end < 15
        for values in found.values():
            assert (values[row, end:] == values[row, end]).all()
    assert abs(found["o2"][:, -1]).min() > 0.2094


@pytest.mark.parametrize("copy", ["replay", "deepcopy"])
@pytest.mark.parametrize("stream", [{"by": "seed"}, {"by": "tape", "numbers": 4}])
def test_a_restored_environment_continues_identically(copy, stream):
    system = loop(
        Feedback([[0.0, 12.0, 3.0]]), env="Pendulum-v1", copy=copy,
        noise={"stream": stream, "observation": {"scale": 0.01}, "action": {"scale": 0.5}},
    )  # fmt: skip
    noise = tape(system, 4)
    check_restored(system, noise, course(system, noise)[0])


def test_an_environment_may_bring_its_own_hook():
    system, replayed = odd(copy="hook"), odd()
    noise = tape(system, 4)
    check_restored(system, noise, course(replayed, noise)[0])
    with pytest.raises(UsageError, match="snapshot, restore"):
        pole(copy="hook")


@pytest.mark.parametrize("by", ["tape", "seed"])
@pytest.mark.parametrize("at", ["reset", "step"])
def test_a_hook_does_not_have_to_store_the_generator(by, at, monkeypatch):
    monkeypatch.setattr(Odd, "snapshot", lambda env: env.x)
    monkeypatch.setattr(Odd, "restore", lambda env, x: setattr(env, "x", x))
    noise = {"stream": {"by": by, "at": at, "numbers": 2}}
    system, replayed = odd(copy="hook", noise=noise), odd(noise=noise)
    tapes = tape(system, 4)
    check_restored(system, tapes, course(replayed, tapes)[0])


def test_noise_on_the_start():
    options = {"env": "Pendulum-v1", "signals": {"rate": 2}}
    still = loop(None, noise={"stream": {"by": "none"}}, **options)
    system = loop(None, noise={"stream": {"by": "none"}, "initial": {"scale": [0.0, 2.0]}}, **options)
    rows = np.array([[5.0, 0.25], [0.0, -1.0]])
    moved = system.signals(system.initial(rows))["rate"]
    expected = still.signals(still.initial(np.zeros((2, 0))))["rate"] + np.array([0.5, -2.0])
    np.testing.assert_allclose(moved, expected, rtol=1e-6)
    pole_start = loop(None, env="CartPole-v1", noise={"stream": {"by": "none"}, "initial": {"scale": 0.1}})
    assert pole_start.noise_size == 4


@pytest.mark.parametrize("kind", ["raising", "missing", "hanging"])
def test_rollouts_that_break_down_are_counted(kind):
    def estimate(system):
        problem = avrare.Problem(system, avrare.stl("always (x > -2)"), STEPS, chunk=10)
        return avrare.estimate(problem, "mc", rollouts=60, seed=2)

    calm = course(odd(), NoiseSource(2, 1).normals(0, 0, np.arange(60)[:, None], np.arange(STEPS + 1)))[0]
    broken = int((calm["x"] > LIMIT).any(axis=1).sum())
    result = estimate(odd(kind, step_timeout=0.1 if kind == "hanging" else None))
    assert 3 < broken < 57
    assert result.errors == broken
    message = {"raising": "beyond the limit", "missing": "NaN", "hanging": "did not end within 0.1 s"}[kind]
    assert message in result.health["errors"]


def test_an_environment_that_is_not_deterministic():
    problem = avrare.Problem(odd("careless"), avrare.stl("always (x < 3)"), 6, chunk=10)
    assert "differs" in capabilities(problem.system).reason
    with pytest.raises(avrare.UsageError, match="ams must continue rollouts from others"):
        avrare.estimate(problem, "ams", particles=20, discard=4, runs=1)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"env": "CartPole-v9"}, "unknown environment 'CartPole-v9'"),
        ({"env": "CartPole-v1", "options": {"wheels": 4}}, "wheels"),
        ({"env": "CartPole-v1", "signals": {"z": 7}}, "signals.z: the observation has entries 0..3"),
        ({"env": "CartPole-v1", "noise": {"observation": {"scale": [1, 2]}}}, "2 scales for 4 numbers"),
        (
            {"env": "CartPole-v1", "noise": {"initial": {"attribute": "wheel", "scale": 1}}},
            "not a numeric state",
        ),
    ],
)
def test_environments_that_cannot_be_built(options, message):
    with pytest.raises(UsageError, match=message):
        build(GymnasiumConfig(**options))


@pytest.mark.parametrize(
    ("kind", "message"),
    [("stillborn", "start raised OSError: no display"), ("longer", "observation has the size 1, .* 2")],
)
def test_a_failing_reset_is_reported_before_anything_runs(kind, message, tmp_path):
    path = tmp_path / "odd.yaml"
    simulator = f"{{plugin: gymnasium, env: Odd-v0, options: {{kind: {kind}}}, signals: {{x: 0}}}}"
    rest = 'specifications: {low: {stl: "always (x < 1)"}}\nestimator: {plugin: mc}\n'
    path.write_text(f"name: odd\nsteps: 2\nsimulator: {simulator}\n{rest}")
    with pytest.raises(AvrareError, match=message):
        avrare.load(path).problem("low")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"env": "os:CartPole-v1"}, "would run code of module 'os'"),
        ({"env": "tests.toys:Mine-v0"}, "not an installed plugin"),
        ({"env": "CartPole-v1", "signals": {"reward": 1}}, "is not a valid signal name"),
        ({"env": "CartPole-v1", "signals": {"a b": 1}}, "is not a valid signal name"),
        ({"env": "CartPole-v1", "signals": {"x": -1}}, "count from 0"),
        ({"env": "CartPole-v1", "copy": "clone"}, "copy"),
        ({"env": "CartPole-v1", "noise": {"action": {"scale": -1.0}}}, "greater than or equal to 0"),
        ({"env": "CartPole-v1", "noise": {"observation": {"scale": [0.1, -1.0]}}}, "or equal to 0"),
    ],
)
def test_invalid_options_of_a_scenario(options, message):
    with pytest.raises(ValueError, match=message):
        GymnasiumConfig(**options)
