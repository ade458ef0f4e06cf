"""Worlds one at a time are one system of values, with noise on what they see and do, and drawn options."""

import pickle

import numpy as np
import pytest
from scipy import stats

import avrare
from avrare.base import batch
from avrare.base.errors import UsageError
from avrare.rollout.noise import NoiseSource
from avrare.stack.closed_loop import ClosedLoop
from avrare.worlds import Channel, Noisy, Worlds, as_system
from avrare.worlds.worlds_simulator import DrawnWorlds

STEPS = 12
COPIES = ("replay", "deepcopy", "hook")


def tape(n, steps=STEPS, size=1, seed=0):
    return NoiseSource(seed, size).normals(0, 0, np.arange(n)[:, None], np.arange(steps + 1))


def course(system, noise, state=None, since=0):
    """Return signals at every step from ``since`` on, and the last state."""
    state = system.initial(noise[:, 0]) if state is None else state
    found = [system.signals(state)["x"]]
    for t in range(since + 1, noise.shape[1]):
        state = system.step(state, noise[:, t])
        found.append(system.signals(state)["x"])
    return np.stack(found, axis=1), state


def test_a_world_equals_a_batched_system(toys):
    noise = tape(20)
    one, _ = course(as_system(toys.Walk), noise)
    other, _ = course(toys.BatchWalk(), noise)
    np.testing.assert_array_equal(one, other)


def test_a_row_does_not_depend_on_its_neighbours(toys):
    noise, system = tape(9), as_system(toys.Vector, toys.Push())
    together, _ = course(system, noise)
    for row in range(9):
        alone, _ = course(system, noise[row : row + 1])
        np.testing.assert_array_equal(alone[0], together[row])


@pytest.mark.parametrize("copy", COPIES)
def test_a_state_is_a_value(toys, copy):
    """Snapshot, run on, restore, run again: the same; another noise: another course, whoever is first."""
    system, noise, other = as_system(toys.Hooked, toys.Push(), copy=copy), tape(6), tape(6, seed=1)
    _, middle = course(system, noise[:, :6])
    first, _ = course(system, noise, middle, 5)
    elsewhere, _ = course(system, other, middle, 5)
    again, _ = course(system, noise, middle, 5)
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first[:, 1:], elsewhere[:, 1:])
    whole, _ = course(as_system(toys.Hooked, toys.Push()), noise)
    np.testing.assert_array_equal(whole[:, 5:], first)


@pytest.mark.parametrize("copy", COPIES)
def test_rows_are_taken_and_concatenated(toys, copy):
    system, noise = as_system(toys.Hooked, copy=copy), tape(6)
    whole, _ = course(system, noise)
    _, middle = course(system, noise[:, :6])
    index = np.array([4, 4, 0, 2, 4])
    joined = batch.concatenate([batch.take(middle, index), batch.take(middle, slice(1, 3))])
    rows = np.concatenate([index, [1, 2]])
    found, _ = course(system, noise[rows], joined, 5)
    np.testing.assert_array_equal(found, whole[rows, 5:])


def test_a_state_is_pickled_as_its_inputs(toys):
    system, noise = as_system(toys.Hooked, toys.Push(), copy="hook"), tape(4)
    whole, _ = course(system, noise)
    _, middle = course(system, noise[:, :6])
    content = pickle.dumps(middle)
    assert b"Hooked" not in content
    travelled = pickle.loads(content)
    elsewhere = pickle.loads(pickle.dumps(system))
    found, _ = course(elsewhere, noise, travelled, 5)
    np.testing.assert_array_equal(found, whole[:, 5:])


def test_worlds_are_reused(toys):
    made = []

    def make():
        made.append(toys.Walk())
        return made[-1]

    system = as_system(make)
    for seed in range(3):
        course(system, tape(8, seed=seed))
    assert len(made) == 8
    _, states = course(system, tape(8, seed=9))
    course(system, tape(8, seed=10))  # takes their worlds away
    course(system, tape(8, STEPS + 2, seed=9), states, STEPS)
    assert len(made) == 8


def test_without_reuse_every_rollout_has_a_new_world(toys):
    noise = tape(5)
    expected, _ = course(as_system(toys.Walk), noise)
    leaky = as_system(toys.Leaky, reuse=False)
    for _ in range(2):
        np.testing.assert_array_equal(course(leaky, noise)[0], expected)
    reused = as_system(toys.Leaky)
    course(reused, noise)
    assert not np.array_equal(course(reused, noise)[0], expected)


def test_a_world_in_a_closed_loop_equals_a_batched_system(toys):
    noise = tape(4)
    loop = ClosedLoop(Worlds(toys.Walk, dt=0.1), controller=toys.Push())
    np.testing.assert_array_equal(course(loop, noise)[0], course(as_system(toys.Walk, toys.Push()), noise)[0])


def test_counts(toys):
    system, noise = as_system(toys.Hooked, toys.Push()), tape(2)
    _, middle = course(system, noise[:, :6])
    _, on = course(system, noise, middle, 5)
    assert system.counts(on)["replayed_steps"].tolist() == [0, 0]
    _, branched = course(system, noise, middle, 5)
    assert system.counts(branched)["replayed_steps"].tolist() == [5, 5]
    assert system.counts(branched)["acted"].tolist() == [STEPS, STEPS]
    assert "replayed_steps" not in as_system(toys.Hooked, copy="hook").counts(branched)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"copy": "clone"}, "clone"),
        ({"step_timeout": 0.0}, "positive"),
        ({"copy": "hook"}, "snapshot, restore"),
    ],
)
def test_wrong_arguments(toys, arguments, message):
    with pytest.raises(UsageError, match=message):
        Worlds(toys.Walk, **arguments)


def test_a_world_in_place_of_a_factory_is_refused(toys):
    with pytest.raises(UsageError, match="by a class or a function, not by a Walk object") as caught:
        as_system(toys.Walk())
    assert caught.value.hint == "pass the class: Walk, not Walk()"


def test_signals_that_change(toys):
    class Odd(toys.Walk):
        def signals(self):
            return {"x": self.x} if self.x < 0 else {"x": self.x, "y": 0.0}

    with pytest.raises(UsageError, match="same signals"):
        course(as_system(Odd), tape(9))


def test_arrays_given_to_a_world_are_read_only(toys):
    class Scribbling(toys.Walk):
        def step(self, action, noise):
            action[:] = 0.0

    problem = avrare.Problem(as_system(Scribbling, toys.Push()), avrare.stl("always (x < 1)"), 3, chunk=5)
    result = avrare.estimate(problem, "mc", rollouts=10)
    assert result.errors == 10
    assert "read-only" in result.health["errors"]


@pytest.mark.parametrize(
    ("law", "reference"),
    [("normal", stats.norm(0, 2)), ("uniform", stats.uniform(-2, 4)), ("laplace", stats.laplace(0, 2))],
)
def test_a_channel_has_its_law(law, reference):
    normals = np.array([-3.0, -1.0, -0.1, 0.4, 1.7, 6.0])
    found = Channel(6, 2.0, law)(normals)
    np.testing.assert_allclose(found, reference.isf(stats.norm.sf(normals)), rtol=1e-9)


def test_every_channel_reads_its_own_numbers(toys):
    channels = {"action": Channel(1, 10.0), "observation": Channel(1, 100.0), "initial": Channel(1, 1000.0)}
    system = as_system(lambda: Noisy(toys.Displaced(), **channels), toys.Push())
    assert system.noise_size == 4
    own, action, observation, initial = np.eye(4)
    zero = np.zeros(4)
    rows = np.stack([zero, own, action, observation, initial])
    state = system.initial(rows)
    np.testing.assert_array_equal(state.world.signals["x"], [0.0, 0.1, 0.0, 0.0, 1000.0])
    np.testing.assert_array_equal(state.world.seen[:, 0], [0.0, 0.1, 0.0, 100.0, 1000.0])
    start = system.initial(np.zeros((5, 4)))
    after = system.step(start, rows)
    np.testing.assert_allclose(after.world.signals["x"], [0.0, 0.1, 10.0, 0.0, 0.0])
    np.testing.assert_allclose(after.world.seen[:, 0], [0.0, 0.1, 10.0, 100.0, 0.0])
    acting = system.step(state, np.zeros((5, 4)))  # on what was seen
    np.testing.assert_allclose(acting.world.signals["x"][3], -10.0)


@pytest.mark.parametrize("copy", ["hook", "deepcopy", "replay"])
def test_a_noisy_world_is_copied_with_its_noise(toys, copy):
    class Both(toys.Hooked):
        def displace(self, delta):
            self.x += float(delta[0])

    system = as_system(lambda: Noisy(Both(), observation=Channel(1, 1.0)), toys.Push(), copy=copy)
    noise = np.random.default_rng(0).normal(size=(3, 5, 2))
    state = system.initial(noise[:, 0])
    courses = []
    for _ in range(3):
        on = system.step(system.step(state, noise[:, 1]), noise[:, 2])
        courses.append(np.concatenate([on.world.seen, on.world.signals["x"][:, None]], axis=1))
    np.testing.assert_array_equal(courses[0], courses[1])
    np.testing.assert_array_equal(courses[0], courses[2])


def test_arguments_that_do_not_fit_are_refused(toys):
    with pytest.raises(UsageError, match="no displace"):
        Noisy(toys.Walk(), initial=Channel(1))
    system = as_system(lambda: Noisy(toys.Walk(), action=Channel(2)), toys.Push())
    with pytest.raises(UsageError, match="noise on 2 numbers of an action, which has 1"):
        system.step(system.initial(np.zeros((1, 3))), np.zeros((1, 3)))


class Drifting:
    """A walk with a drift of its own."""

    noise_size = 1

    def __init__(self):
        self.options = {"drift": 0.0}

    def assign(self, values):
        self.options |= values

    def reset(self, noise):
        self.x, self.drift = float(noise[0]), self.options["drift"]

    def step(self, action, noise):
        self.x += self.drift + float(noise[0])

    def signals(self):
        return {"x": self.x}

    def snapshot(self):
        return self.x, self.drift

    def restore(self, snapshot):
        self.x, self.drift = snapshot


def drive(worlds, world, noise):
    for row in noise:
        world = worlds.step(world, None, row)
    return world


@pytest.mark.parametrize("copy", ["replay", "deepcopy", "hook"])
def test_branches_keep_their_numbers(copy):
    worlds = DrawnWorlds(Drifting, copy=copy).drawing({"drift": None})
    assert worlds.noise_size == 1
    noise = np.random.default_rng(0).standard_normal((7, 3, 1))
    drift = np.array([0.0, 10.0, 20.0])
    start = worlds.reset_drawn(noise[0], {"drift": drift})
    middle = drive(worlds, start, noise[1:4])
    order = np.array([2, 2, 0])
    copies = batch.take(middle, order)
    end = drive(worlds, copies, noise[4:])
    expected = noise[:4].sum(axis=0)[order, 0] + noise[4:].sum(axis=0)[:, 0] + 6 * drift[order]
    np.testing.assert_allclose(worlds.signals(end)["x"], expected)
    elsewhere, again = pickle.loads(pickle.dumps((worlds, copies)))  # as workers do
    found = elsewhere.signals(drive(elsewhere, again, noise[4:]))
    np.testing.assert_array_equal(found["x"], worlds.signals(end)["x"])


def test_without_draws_nothing_changes():
    worlds = DrawnWorlds(Drifting)
    noise = np.random.default_rng(0).standard_normal((3, 2, 1))
    end = drive(worlds, worlds.reset(noise[0]), noise[1:])
    np.testing.assert_allclose(worlds.signals(end)["x"], noise.sum(axis=0)[:, 0])
