"""The noise tape: known answers of Philox, laws, and independence of the order and company it is drawn in."""

import itertools

import numpy as np
import pytest

from avrare.base.errors import UsageError
from avrare.base.philox import philox
from avrare.rollout.noise import NoiseSource

ONES = 0xFFFFFFFF
PI = (0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344, 0xA4093822, 0x299F31D0)
KNOWN_ANSWERS = [
    ((0, 0, 0, 0), (0, 0), "6627e8d5 e169c58d bc57ac4c 9b00dbd8"),
    ((ONES,) * 4, (ONES,) * 2, "408f276d 41c83b0e a20bc7c6 6d5451fd"),
    (PI[:4], PI[4:], "d16cfe09 94fdcceb 5001e420 24126ea1"),
]


@pytest.mark.parametrize(("counter", "key", "expected"), KNOWN_ANSWERS)
def test_philox_known_answers(counter, key, expected):
    """Reproduce the test vectors of Random123 1.14 (kat_vectors, philox4x32 with ten rounds)."""
    arrays = [np.array([word], dtype=np.uint64) for word in (*counter, *key)]
    words = philox(tuple(arrays[:4]), tuple(arrays[4:]))
    assert " ".join(f"{int(word[0]):08x}" for word in words) == expected


@pytest.mark.parametrize("size", [1, 2, 3, 8])
def test_any_number_can_be_drawn_alone(size):
    noise = NoiseSource(7, size)
    run, stage, particle = np.arange(60) % 7, np.arange(60) % 3, np.arange(60)
    steps = np.arange(11)
    whole = noise.normals(run[:, None], stage[:, None], particle[:, None], steps)
    assert whole.shape == (60, 11, size)
    assert whole.flags.c_contiguous
    for row, step in itertools.product((0, 31, 59), (0, 5, 10)):
        alone = noise.normals(run[row], stage[row], particle[row], step)
        np.testing.assert_array_equal(alone, whole[row, step])
    backwards = noise.normals(run[::-1, None], stage[::-1, None], particle[::-1, None], steps[::-1])
    np.testing.assert_array_equal(backwards[::-1, ::-1], whole)


def test_channels_do_not_depend_on_how_many_there_are():
    three, eight = (NoiseSource(1, size).normals(0, 0, np.arange(5), 2) for size in (3, 8))
    np.testing.assert_array_equal(three, eight[:, :3])


def test_law_of_the_normals():
    x = NoiseSource(11, 4).normals(0, 0, np.arange(250_000), 3).ravel()
    n = len(x)
    for power, moment, variance in ((1, 0, 1), (2, 1, 2), (3, 0, 15), (4, 3, 96)):
        assert abs((x**power).mean() - moment) < 4 * np.sqrt(variance / n)
    for level, tail in ((2.0, 2.275013194817921e-2), (3.0, 1.3498980316301e-3), (4.0, 3.16712418331e-5)):
        for hits in ((x > level).sum(), (x < -level).sum()):
            assert abs(hits - n * tail) < 4 * np.sqrt(n * tail)


def test_large_seeds_share_no_streams_with_small_ones():
    small, large = NoiseSource(5, 1), NoiseSource(5 + 2**32, 1)
    drawn = [source.normals(run, 0, 0, 0)[0] for source in (small, large) for run in range(4)]
    assert len(set(drawn)) == 8


def test_choices_are_uniform_and_independent_of_the_noise():
    noise = NoiseSource(3, 1)
    u = noise.choices(0, 1, np.arange(100_000))
    assert ((u > 0) & (u < 1)).all()
    assert abs(u.mean() - 0.5) < 4 / np.sqrt(12 * u.size)
    assert abs((u < 0.1).mean() - 0.1) < 4 * np.sqrt(0.09 / u.size)
    for step in (0, 1):
        x = noise.normals(0, 1, np.arange(100_000), step)[:, 0]
        for y in (x, x**2):
            assert abs(np.corrcoef(u, y)[0, 1]) < 4 / np.sqrt(u.size)


@pytest.mark.parametrize("seed", [-1, 1.0, True, "1", None])
def test_seed_must_be_a_count(seed):
    with pytest.raises(UsageError, match="seed"):
        NoiseSource(seed, 1)
