"""Segments against a dense scan of the ellipse, for formulas of every kind."""

import numpy as np
import pytest

import avrare
from avrare.rollout.noise import NoiseSource
from avrare.testing import problems
from avrare_linear.ellipse import Segments, Slicer, draw_angles
from avrare_linear.gaussian import simulate_signals
from avrare_linear.predicates import AffineFormula
from plain_systems import LogProduct, Still

ANGLES = np.linspace(0.0, 2.0 * np.pi, 3000, endpoint=False) + 1e-5


class Plane(Still):
    """Two independent walks."""

    noise_size = 2

    def initial(self, noise):
        return {"p": noise[:, 0], "q": noise[:, 1]}

    def step(self, state, noise):
        return {"p": 0.8 * state["p"] + noise[:, 0], "q": 0.9 * state["q"] + 0.3 * noise[:, 1]}


def ellipses(noise_size, steps, many=12):
    source, chains = NoiseSource(11, noise_size), np.arange(many)[:, None]
    return tuple(source.normals(0, stage, chains, np.arange(steps + 1)) for stage in (0, 1))


def robustness_along(system, formula, tape, other):
    """Return (M, K) at the angles of the scan, by running the system."""
    cosine, sine = np.cos(ANGLES)[:, None, None], np.sin(ANGLES)[:, None, None]
    tapes = (tape[:, None] * cosine + other[:, None] * sine).reshape(-1, *tape.shape[1:])
    return formula.robustness(simulate_signals(system, tapes))[:, 0].reshape(len(tape), -1)


def check(system, text, steps, levels, many=12):
    formula = avrare.stl(text, warn=False)
    slicer = Slicer.of(system, steps, formula)
    tape, other = ellipses(system.noise_size, steps, many)
    rho = robustness_along(system, formula, tape, other)
    mixed = 0
    for level in levels:
        expected = rho < level
        found = slicer.segments(tape, other, level)
        inside = found.contains(np.tile(ANGLES, (many, 1)))
        assert (inside == expected).all(), (text, level)
        assert found.length == pytest.approx(2 * np.pi * expected.mean(axis=1), abs=0.05)
        mixed += int((expected.any(axis=1) & ~expected.all(axis=1)).sum())
    assert mixed >= many // 2, "the levels cut hardly any ellipse"


REFERENCE = {
    "a": (problems.conjunction(-2.0), (0.5, 1.0, 1.8)),
    "b": (problems.linear(3.7, 100), (2.5, 3.0, 3.5)),
    "d": (problems.walk(2.5), (0.8, 1.5, 2.0)),
    "e": (problems.ornstein_uhlenbeck(3.0), (0.8, 1.2, 1.6)),
    "g": (problems.reach(0.5), (0.6, 1.5, 3.0)),
    "h": (problems.response(20), (0.0, 0.3, 0.6)),
}


@pytest.mark.parametrize("family", REFERENCE)
def test_reference_problems(family):
    problem, levels = REFERENCE[family]
    check(problem.system, problem.formula, problem.steps, levels, many=6)


def test_lognormals_after_the_logarithm():
    check(LogProduct(5), "log_product < 1.2", 0, (0.0, 0.4, 0.8))


@pytest.mark.parametrize(
    "text",
    [
        "always (abs(p) < 2 or abs(q) < 0.5)",
        "always[2:5] (max(p, -2 * q, p + q) - min(q, 1) <= 3)",
        "eventually[0:6] (p > 1 and not (q > 0.2))",
        "(p < 2) until[0:7] (q + p / 2 > 1)",
        "always (p > 1 -> eventually[0:3] (q < 0.3 * (p - 1)))",
        "not always (p - q < 2)",
        "always (p < 3 and once[0:2] (q > -1))",
        "(q > -1) since[0:4] (p > -3)",
        "next (p < 1) and always (q < 1.5)",
        "always (q < 1 or p == 0) and eventually[0:2] (p != 0.5)",
        "historically (p < 1) and p < 0.5",
        "always (p < 2 and 1 < 2)",
    ],
)
def test_formulas_of_every_kind(text):
    check(Plane(), text, 7, (-0.4, 0.0, 0.3, 0.7))


def test_half_open_until():
    formula = avrare.stl("(p < 1) until[1:6] (q > 0.5)", until="half-open")
    slicer, (tape, other) = Slicer.of(Plane(), 7, formula), ellipses(2, 7)
    rho = robustness_along(Plane(), formula, tape, other)
    inside = slicer.segments(tape, other).contains(np.tile(ANGLES, (12, 1)))
    assert (inside == (rho < 0)).all()
    closed = Slicer.of(Plane(), 7, avrare.stl("(p < 1) until[1:6] (q > 0.5)"))
    assert (closed.segments(tape, other).contains(np.tile(ANGLES, (12, 1))) != inside).any()


def test_levels_may_differ_from_ellipse_to_ellipse_and_from_sample_to_sample():
    slicer, (tape, other) = Slicer.of(Plane(), 7, avrare.stl("always (p < 2)")), ellipses(2, 7)
    levels = np.linspace(-0.5, 1.5, 12)
    together = slicer.segments(tape, other, levels)
    for row in range(12):
        alone = slicer.segments(tape[row : row + 1], other[row : row + 1], float(levels[row]))
        assert together.length[row] == alone.length[0]
    late = np.where(np.arange(8) < 4, -50.0, 0.5)  # only samples from 4 on can fail
    found = slicer.segments(tape, other, np.tile(late, (12, 1)))
    angles = np.tile(ANGLES, (12, 1))
    rho = robustness_along(Plane(), avrare.stl("always[4:7] (p < 2)"), tape, other)
    assert (found.contains(angles) == (rho < 0.5)).all()


def test_draws_are_uniform_on_the_segments():
    low, high = np.array([[0.5, 2.0, 6.0]]), np.array([[1.0, 3.5, 6.0]])
    many = 20_000
    segments = Segments(np.repeat(low, many, axis=0), np.repeat(high, many, axis=0))
    angles = draw_angles(segments, (np.arange(many) + 0.5) / many)
    assert segments.contains(angles[:, None]).all()
    assert np.mean(angles < 1.0) == pytest.approx(0.25, abs=1e-3)
    assert np.mean(angles < 2.75) == pytest.approx(0.625, abs=1e-3)
    nothing = Segments(np.full((2, 1), 2 * np.pi), np.full((2, 1), 2 * np.pi))
    assert draw_angles(nothing, np.array([0.1, 0.9])).tolist() == [0.0, 0.0]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("always (p * q < 1)", r"the term `p \* q` is not affine"),
        ("always (2 * pow(p, 2) < 1)", r"the term `pow\(p, 2\)` is not affine"),
        ("always (1 / p < 1)", "the term `1 / p` is not affine"),
        ("always ((p < 1) iff (q < 1))", "iff"),
        ("always (q > 0 xor p > 0)", "xor"),
        ("forall o in others: always (gap_of(o) > 0)", "quantifiers"),
    ],
)
def test_refused_by_name(text, message):
    with pytest.raises(avrare.UsageError, match=message):
        AffineFormula.of(avrare.stl(text, warn=False))


def test_a_formula_without_signals_is_refused():
    with pytest.raises(avrare.UsageError, match="reads no signal"):
        Slicer.of(Plane(), 3, avrare.stl("always true"))


def test_the_four_branches_are_curved():
    problem = problems.four_branch(7.0)
    with pytest.raises(avrare.UsageError, match=r"pow\(u0 - u1, 2\)"):
        Slicer.of(problem.system, 0, avrare.stl(problem.formula))
