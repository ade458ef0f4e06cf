"""Noise on actions, observations and the start."""

import numpy as np
import pytest
from scipy import stats

from avrare.base.errors import UsageError
from avrare.worlds import Channel, Noisy, as_system


@pytest.mark.parametrize(
    ("law", "reference"),
    [("normal", stats.norm(0, 2)), ("uniform", stats.uniform(-2, 4)), ("laplace", stats.laplace(0, 2))],
)
def test_a_channel_has_its_law(law, reference):
    normals = np.array([-3.0, -1.0, -0.1, 0.4, 1.7, 6.0])
    found = Channel(6, 2.0, law)(normals)
    np.testing.assert_allclose(found, reference.isf(stats.norm.sf(normals)), rtol=1e-9)


def test_every_channel_reads_its_own_numbers(toys):
    def make():
        return Noisy(
            toys.Displaced(),
            action=Channel(1, 10.0),
            observation=Channel(1, 100.0),
            initial=Channel(1, 1000.0),
        )

    system = as_system(make, toys.Push())
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
