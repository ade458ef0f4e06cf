"""An environment's random numbers, made of the noise."""

import gymnasium
import numpy as np
import pytest
from scipy import stats

from avrare_gymnasium.stream import Stream, TapeGenerator, bits, reseed

NORMALS = np.array([0.3, -1.2, 2.0, 0.01, -0.5, 0.9])


@pytest.fixture
def tape():
    generator = TapeGenerator()
    generator.load(NORMALS)
    return generator


def test_the_stream_gives_the_numbers_of_the_tape_in_order(tape):
    assert tape.normal(1.0, 2.0) == 1.0 + 2.0 * 0.3
    np.testing.assert_allclose(tape.uniform(-1.0, 1.0, size=(2,)), 2 * stats.norm.cdf(NORMALS[1:3]) - 1)
    assert tape.integers(10) == int(10 * stats.norm.cdf(0.01))
    assert tape.random() == pytest.approx(stats.norm.cdf(-0.5))
    np.testing.assert_array_equal(tape.standard_normal((1, 1)), [[0.9]])


def test_draws_beyond_the_tape_are_seeded_by_it():
    found = []
    for first in (0.3, 0.3, 0.4):
        generator = TapeGenerator()
        generator.load(np.array([first, 0.0]))
        found.append([*generator.random(5), generator.choice(1000), generator.exponential()])
    assert found[0] == found[1]
    assert not set(found[0][2:]) & set(found[2][2:])
    assert 0.0 < min(found[0]) <= max(found[0][:5]) < 1.0


def test_integers_stay_in_range():
    generator = TapeGenerator()
    generator.load(np.array([40.0, -40.0, 40.0]))
    assert (generator.integers(3, 7), generator.integers(3, 7)) == (6, 3)
    assert generator.integers(3, 7, endpoint=True) == 7


def test_every_law_is_kept():
    generator = TapeGenerator()
    drawn = []
    for row in np.random.default_rng(0).normal(size=(2000, 1)):
        generator.load(row)
        drawn.append([generator.uniform(2.0, 5.0), generator.uniform(2.0, 5.0)])
    for column in np.array(drawn).T:  # the tape's own, and what lies beyond
        assert stats.kstest(column, stats.uniform(2.0, 3.0).cdf).pvalue > 1e-3


def test_the_key_depends_on_every_bit():
    assert bits(NORMALS) == bits(NORMALS.copy()) != bits(NORMALS + 1e-16)
    generator = np.random.Generator(np.random.PCG64(1))
    reseed(generator, bits(NORMALS))
    first = generator.random(3)
    reseed(generator, bits(NORMALS))
    np.testing.assert_array_equal(generator.random(3), first)


def test_steps_reseed_a_shared_generator_in_place():
    env, stream = gymnasium.make("Pendulum-v1"), Stream("seed")
    stream.reset(env, np.array([0.1]), None)
    held = env.unwrapped.np_random
    stream.step(env, np.array([0.5]))
    first = held.random()
    stream.step(env, np.array([0.5]))
    assert held.random() == first
    assert env.unwrapped.np_random is held
    env.unwrapped.np_random = np.random.Generator(np.random.MT19937(0))
    stream.step(env, np.array([0.5]))
    expected = np.random.Generator(np.random.PCG64(bits(np.array([0.5]))))
    assert env.unwrapped.np_random.random() == expected.random()


def test_a_stream_at_the_reset_does_not_reseed_steps():
    env, stream = gymnasium.make("Pendulum-v1"), Stream("seed", at_steps=False)
    stream.reset(env, np.array([0.1]), None)
    before = env.unwrapped.np_random.bit_generator.state
    stream.step(env, np.array([0.5]))
    assert env.unwrapped.np_random.bit_generator.state == before
