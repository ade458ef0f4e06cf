"""Text forms of probabilities, counts and durations, shared by all reports and commands."""

from __future__ import annotations

import math
from collections.abc import Sequence


def format_probability(value: float, digits: int = 3) -> str:
    """Return ``0``, ``0.0123`` or ``3.4e-05``; below 1 as many digits as tell it from 1."""
    if value == 0.0 or value == 1.0:
        return f"{value:.0f}"
    while value < 1.0 and digits < 17 and float(f"{value:.{digits}g}") == 1.0:
        digits += 1
    return f"{value:.{digits}g}" if value >= 1e-3 else f"{value:.1e}"


def format_interval(interval: Sequence[float]) -> str:
    """Return ``0.041 .. 0.06``."""
    low, high = interval
    return f"{format_probability(low, 2)} .. {format_probability(high, 2)}"


def format_narrow(value: float, digits: int = 2) -> str:
    """Return ``0.012`` or ``3.4e-5``, for cells of wide tables."""
    text = f"{value:.{digits - 1}e}" if 0.0 < value < 1e-3 else f"{value:.{digits}g}"
    return text.replace("e-0", "e-")


def format_estimate(probability: float, interval: tuple[float, float]) -> str:
    """Return an estimate with its interval: ``0.0123 (0.01 .. 0.02)``."""
    return f"{format_probability(probability)} ({format_interval(interval)})"


def format_typeset(value: float | None, digits: int = 3) -> str:
    """Return ``0.0123`` or ``3.4 × 10⁻⁵``; a dash for None."""
    if value is None:
        return "–"
    if 0.0 < value < 1e-3:
        return format_scientific(value)
    return format_probability(value, digits)


def format_typeset_interval(interval: Sequence[float]) -> str:
    """Return ``0.041 – 0.06``."""
    low, high = interval
    return f"{format_typeset(low, 2)} – {format_typeset(high, 2)}"


def format_scientific(value: float) -> str:
    """Return ``3.4 × 10¹²``."""
    mantissa, exponent = f"{value:.1e}".split("e")
    return f"{mantissa} × {format_power_of_ten(int(exponent))}"


def format_power_of_ten(exponent: int) -> str:
    """Return ``10⁻³``; 1 and 0.1 are written out."""
    if exponent in (0, -1):
        return "1" if exponent == 0 else "0.1"
    superscripts = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
    return f"10{str(exponent).translate(superscripts)}"


def format_amount(value: float, digits: int = 2) -> str:
    """Return a positive number as ``0.42``, ``7.3``, ``790``, ``1.2k``, ``3.4M`` or ``5.6e9``."""
    if value == 0.0 or not math.isfinite(value):
        return f"{value:g}"
    power = math.floor(math.log10(float(f"{value:.{digits - 1}e}")))  # of the rounded number: 999.7 is 1.0k
    if power < 0 or power >= 9:
        return f"{value:.{digits}g}".replace("e+0", "e").replace("e+", "e")
    thousands = power // 3
    decimals = max(0, digits - 1 - power % 3)
    return f"{value / 1000.0**thousands:.{decimals}f}{'kM'[thousands - 1] if thousands else ''}"


def format_ratio(ratio: float, interval: Sequence[float]) -> str:
    """Return a ratio with its interval, ``0.4 (0.2 .. 0.7)``."""
    low, high = interval
    if high == math.inf:
        return f"at least {format_amount(low)}"
    if ratio == 0.0:
        return f"0 (at most {format_amount(high)})"
    return f"{format_amount(ratio)} ({format_amount(low)} .. {format_amount(high)})"


def format_amount_in_words(value: float) -> str:
    """Return two significant digits for a sentence: ``65``, ``1,900``, ``3.4 million``."""
    rounded = float(f"{value:.1e}")
    if rounded >= 1e9:
        return format_scientific(value)
    if rounded >= 1e6:
        return f"{rounded / 1e6:.3g} million"
    return f"{rounded:,.0f}" if rounded >= 10 else f"{rounded:.2g}"


def format_percent(share: float) -> str:
    """Return ``95 %``."""
    return f"{100.0 * share:.4g} %"


def format_confidence(confidence: float) -> str:
    """Return ``95%``, with as many digits as the confidence has."""
    return f"{100.0 * confidence:.12g}%"


def describe_share(share: float) -> str:
    """Return ``95 %``, ``0.4 %`` below one percent, ``under 0.1 %``: a share of a whole."""
    percent = 100.0 * share
    if 0.0 < percent < 0.1:
        return "under 0.1 %"
    return f"{percent:.1f} %" if 0.0 < percent < 1.0 else f"{percent:.0f} %"


def format_count(number: int, noun: str) -> str:
    """Return ``1 scene`` or ``1,200 scenes``."""
    return f"{number:,} {noun}{'s' * (number != 1)}"


def format_difference(value: float) -> str:
    """Return a difference with its sign: ``+0.012``."""
    return f"{value:+.2g}" if value else "0"


def format_signed_interval(interval: Sequence[float]) -> str:
    """Return ``-0.004 .. +0.02``."""
    return " .. ".join(map(format_difference, interval))


def format_robustness(value: float) -> str:
    """Return three significant digits: ``-0.00123``, ``12.3``, ``inf``."""
    return f"{value:.3g}"


def format_clock(seconds: float) -> str:
    """Return a running time as ``0:07``, ``12:34`` or ``3:25:45``."""
    if not math.isfinite(seconds) or seconds > 359_999:  # 99:59:59
        return "days"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"


def format_duration(seconds: float) -> str:
    """Return a rounded duration: ``40 s``, ``4 min``, ``3 h``, ``2 days``."""
    for size, unit in ((86_400.0, "days"), (3_600.0, "h"), (60.0, "min")):
        if seconds >= 1.5 * size:
            return f"{seconds / size:.0f} {unit}"
    return f"{seconds:.0f} s" if seconds >= 1.0 else "under 1 s"
