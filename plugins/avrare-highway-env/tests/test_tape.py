"""Random numbers from the tape."""

import numpy as np
import pytest

from avrare_highway_env.tape import TapeRandom


def numbers(n, seed=0):
    return np.random.default_rng(seed).standard_normal(n)


def test_every_draw_uses_the_next_number():
    tape = TapeRandom(np.array([0.0, 0.0, 1.5, 0.0, -9.0, 9.0]))
    assert tape.random() == 0.5
    assert tape.uniform(-5.0, 5.0) == 0.0
    assert tape.normal(2.0, 2.0) == 5.0
    assert tape.integers(3) == 1
    assert tape.integers(2, 5) == 2
    assert tape.integers(2, 5) == 4
    assert tape.used == 6


def test_draws_have_the_laws_of_their_names():
    tape = TapeRandom(numbers(20_000))
    uniform = np.array([tape.uniform(2.0, 4.0) for _ in range(10_000)])
    assert uniform.mean() == pytest.approx(3.0, abs=0.02)
    assert uniform.var() == pytest.approx(4 / 12, abs=0.01)
    counts = np.bincount([tape.integers(4) for _ in range(10_000)], minlength=4)
    assert np.abs(counts - 2500).max() < 200


def test_choices_with_and_without_replacement():
    tape = TapeRandom(numbers(4000))
    names = [tape.choice(["a", "b", "c"]) for _ in range(900)]
    assert all(200 < names.count(name) < 400 for name in "abc")
    assert 0 <= tape.choice(np.int64(3)) < 3
    pairs = [tape.choice(range(4), size=2, replace=False) for _ in range(500)]
    assert all(a != b for a, b in pairs)
    assert len({(int(a), int(b)) for a, b in pairs}) == 12
    doubles = [tape.choice(2, size=2) for _ in range(100)]
    assert any(a == b for a, b in doubles)


def test_beyond_its_end_the_tape_seeds_the_draws():
    def draws(tape):
        return [tape.normal() for _ in range(10)]

    one, again, other = (draws(TapeRandom(numbers(3, seed))) for seed in (1, 1, 2))
    assert one == again
    assert len(set(one)) == 10
    assert set(one).isdisjoint(other)
    assert draws(TapeRandom(np.zeros(0))) == draws(TapeRandom(np.zeros(0)))
    tail = draws(TapeRandom(np.nextafter(numbers(3, 1), 9.0)))[3:]
    assert set(tail).isdisjoint(one)
