"""Arithmetic on lanes: accurate, the same bits compiled or not, and packed instructions."""

import re

import numpy as np
import pytest

from avrare_mpc.riccati import functions, jit, lanes
from avrare_mpc.riccati.lanes import WIDTH

RNG = np.random.default_rng(0)
ANGLES = np.r_[RNG.uniform(-2, 2, 240), 0.0, -0.0, 0.78, np.pi / 2, -np.pi / 2, 3e4, -7.0, 1e-300]
SCALED = np.concatenate([RNG.uniform(-37, 37, 240), [0.0, -0.0, 37.0, -37.0, 1e-9, -1e-9, 0.3, -700.0]])
POSITIVE = np.r_[np.exp(RNG.uniform(-600, 600, 240)), 1.0, 2.0, 0.5, 1e-300, 1e300, 3.0, 1.5, 0.7]


def rows(values):
    return values.reshape(-1, WIDTH)


def test_functions_are_accurate(plain):
    f = plain.functions
    sine, cosine = (np.concatenate(part) for part in zip(*map(f.sine_and_cosine, rows(ANGLES)), strict=True))
    np.testing.assert_allclose(sine, np.sin(ANGLES), rtol=1e-15, atol=1e-16)
    np.testing.assert_allclose(cosine, np.cos(ANGLES), rtol=1e-15, atol=3e-16)
    soft, slope = (np.concatenate(part) for part in zip(*map(f.softplus, rows(SCALED)), strict=True))
    np.testing.assert_allclose(soft, np.logaddexp(0.0, SCALED), rtol=1e-15)
    np.testing.assert_allclose(slope, 1.0 / (1.0 + np.exp(-SCALED)), rtol=2e-15)
    value = np.concatenate([f.logarithm(row, np.full(WIDTH, 40.0)) for row in rows(POSITIVE)])
    np.testing.assert_allclose(value, np.log(POSITIVE) + 40 * np.log(2.0), rtol=1e-15, atol=2e-14)


@pytest.fixture(scope="module")
def compiled():
    """Return compiled softplus, cosine and logarithm of a row of each, into a memory."""
    soft, cosine, log, load, store = (
        functions.softplus, functions.sine_and_cosine, functions.logarithm, lanes.load, lanes.store,
    )  # fmt: skip

    def evaluate(given, into):
        value, slope = soft(load(given, 0))
        sine, cosine_ = cosine(load(given, 1))
        for row, part in enumerate((value, slope, sine, cosine_, log(load(given, 2), lanes.splat(3.0)))):
            store(into, row, part)

    return jit.numba.njit(error_model="numpy")(evaluate)


def evaluate(compiled, given):
    """Return rows of what ``compiled`` stores for the three rows given."""
    memory = np.zeros((10, WIDTH)).reshape(-1)
    memory = memory[-memory.ctypes.data % 64 // 8 :][: 9 * WIDTH].reshape(9, WIDTH)
    memory[5:8] = given
    compiled(memory[5:].ctypes.data, memory.ctypes.data)
    return memory[:5]


def test_compiled_functions_have_the_bits_of_numpy(plain, compiled):
    f = plain.functions
    for soft, angle, positive in zip(rows(SCALED), rows(ANGLES), rows(POSITIVE), strict=True):
        expected = [*f.softplus(soft), *f.sine_and_cosine(angle), f.logarithm(positive, np.full(WIDTH, 3.0))]
        assert np.array_equal(evaluate(compiled, [soft, angle, positive]), expected)


def test_arithmetic_is_packed(compiled):
    """Find no operation on single numbers, and no call of a mathematical library."""
    evaluate(compiled, np.ones((3, WIDTH)))
    (assembly,) = compiled.inspect_asm().values()
    packed, single = (len(re.findall(rf"\bv?(?:mul|div|add|sub){end}\b", assembly)) for end in ("pd", "sd"))
    assert packed > 60
    assert single == 0
    assert not re.search(r"\b(exp|log1p|log|sin|cos)\b", assembly)


def test_compilation_is_announced_once(tmp_path, monkeypatch, capfd):
    monkeypatch.setattr(jit.numba.config, "CACHE_DIR", str(tmp_path))

    def double(x):
        return 2.0 * x

    for told in (1, 0):  # the second time it is on disk
        with jit.announce("note: compiling"):
            assert jit.entry(double)(2.0) == 4.0
        assert capfd.readouterr().err.count("note: compiling") == told
