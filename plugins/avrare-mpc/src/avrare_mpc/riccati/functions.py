"""Elementary functions of lanes, from additions, multiplications and one division each.

They are accurate to about 1e-15, relatively, and have the same bits on every machine.
"""

from __future__ import annotations

from avrare_mpc.riccati.jit import kernel
from avrare_mpc.riccati.lanes import (
    Lanes,
    any_of,
    below,
    exponent,
    magnitude,
    mantissa,
    nearest,
    select,
    times_power_of_two,
)

_LN2_HIGH, _LN2_LOW = 6.93147180369123816490e-01, 1.90821492927058770002e-10
_LOG2_E, _SQRT2 = 1.4426950408889634, 1.4142135623730951
# pi / 2 in parts of 33 bits (fdlibm): products with small whole numbers are exact
_QUARTER_1, _QUARTER_2 = 1.57079632673412561417e00, 6.07710050630396597660e-11
_QUARTER_3 = 2.02226624879595063154e-21
_TWO_OVER_PI = 0.6366197723675814


@kernel
def smaller(a: Lanes, b: Lanes) -> Lanes:
    """Return the smaller number, ``b`` where one is NaN."""
    return select(a < b, a, b)


@kernel
def larger(a: Lanes, b: Lanes) -> Lanes:
    """Return the larger number, ``b`` where one is NaN."""
    return select(a > b, a, b)


@kernel
def exponential(x: Lanes) -> Lanes:
    """Return e^x for |x| < 700."""
    power = nearest(x * _LOG2_E)
    r = (x - power * _LN2_HIGH) - power * _LN2_LOW
    r2 = r * r
    r4 = r2 * r2
    low = (1.0 + r) + r2 * (1.0 / 2.0 + r * (1.0 / 6.0))
    middle = (1.0 / 24.0 + r * (1.0 / 120.0)) + r2 * (1.0 / 720.0 + r * (1.0 / 5040.0))
    high = (1.0 / 40320.0 + r * (1.0 / 362880.0)) + r2 * (1.0 / 3628800.0 + r * (1.0 / 39916800.0))
    last = 1.0 / 479001600.0 + r * (1.0 / 6227020800.0)
    return times_power_of_two(low + r4 * (middle + r4 * (high + r4 * last)), power)


@kernel
def softplus(z: Lanes) -> tuple[Lanes, Lanes]:
    """Return log(1 + e^z) and its derivative, for |z| < 700."""
    small = exponential(-magnitude(z))
    inverse = 1.0 / ((1.0 + small) * (2.0 + small))
    t = small * (1.0 + small) * inverse  # e / (2 + e): log(1 + e) = 2 artanh(t), t <= 1/3
    derivative = select(z > 0.0, 1.0, small) * (2.0 + small) * inverse
    s = t * t
    s2 = s * s
    s4 = s2 * s2
    a = (1.0 + s * (1.0 / 3.0)) + s2 * (1.0 / 5.0 + s * (1.0 / 7.0))
    b = (1.0 / 9.0 + s * (1.0 / 11.0)) + s2 * (1.0 / 13.0 + s * (1.0 / 15.0))
    c = (1.0 / 17.0 + s * (1.0 / 19.0)) + s2 * (1.0 / 21.0 + s * (1.0 / 23.0))
    d = (1.0 / 25.0 + s * (1.0 / 27.0)) + s2 * (1.0 / 29.0 + s * (1.0 / 31.0))
    series = (a + s4 * b) + s4 * s4 * (c + s4 * d)
    return larger(z, 0.0) + 2.0 * t * series, derivative


@kernel
def logarithm(value: Lanes, power: Lanes) -> Lanes:
    """Return log(value 2^power) for a positive normal value."""
    m, p = mantissa(value), exponent(value) + power
    high = m > _SQRT2
    m, p = select(high, 0.5 * m, m), select(high, p + 1.0, p)
    t = (m - 1.0) / (m + 1.0)
    s = t * t
    series = 1.0 / 19.0 + s * (1.0 / 21.0)
    for n in (17.0, 15.0, 13.0, 11.0, 9.0, 7.0, 5.0, 3.0, 1.0):
        series = 1.0 / n + s * series
    return p * _LN2_HIGH + (p * _LN2_LOW + 2.0 * t * series)


@kernel
def sine_and_cosine(angle: Lanes) -> tuple[Lanes, Lanes]:
    """Return sine and cosine of |angle| < 1e5; beyond, they lose digits."""
    quarter, r = angle * 0.0, angle
    if any_of(magnitude(angle) > 0.78):
        quarter = nearest(angle * _TWO_OVER_PI)
        r = ((angle - quarter * _QUARTER_1) - quarter * _QUARTER_2) - quarter * _QUARTER_3
        quarter = quarter - 4.0 * below(0.25 * quarter)
    s = r * r
    s2 = s * s
    sine = (-1.66666666666666324348e-01 + s * 8.33333333332248946124e-03) + s2 * (
        (-1.98412698298579493134e-04 + s * 2.75573137070700676789e-06)
        + s2 * (-2.50507602534068634195e-08 + s * 1.58969099521155010221e-10)
    )
    sine = r + r * s * sine
    cosine = (4.16666666666666019037e-02 + s * -1.38888888888741095749e-03) + s2 * (
        (2.48015872894767294178e-05 + s * -2.75573143513906633035e-07)
        + s2 * (2.08757232129817482790e-09 + s * -1.13596475577881948265e-11)
    )
    cosine = (1.0 - 0.5 * s) + s2 * cosine
    if any_of(quarter > 0.0):
        odd = ((quarter > 0.5) & (quarter < 1.5)) | (quarter > 2.5)
        sine, cosine = select(odd, cosine, sine), select(odd, sine, cosine)
        sine = select(quarter > 1.5, -sine, sine)
        cosine = select((quarter > 0.5) & (quarter < 2.5), -cosine, cosine)
    return sine, cosine
