"""Arrays, signals and verdicts that parts exchange."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Signals = Mapping[str, NDArray[Any]]


@dataclass(frozen=True)
class Misreading:
    """Errors that noise makes in a quantity that a part measures, and the words for them.

    Attributes:
        values: (N,) the errors; NaN where nothing is read.
        subject: Name of the error, such as "radar".
        above: Words for a positive error, such as "reads {} m too long".
        below: Words for a negative one.
        usual: (N,) errors without noise. Default: 0.
        least: Smallest error that is worth words. Default: 0.
    """

    values: Floats
    subject: str
    above: str
    below: str
    usual: Floats | float = 0.0
    least: float = 0.0


@dataclass(frozen=True)
class Verdict:
    """Verdict of a monitor on the samples 0..t.

    Attributes:
        robustness: (N,) robustness of the prefix at sample 0 (nominal, stl-ams eq. 14).
        violated: (N,) Boolean evaluation of the prefix at sample 0 is false.
        score: (N,) running maximum of how near to failure the particle has come; higher is nearer.
    """

    robustness: Floats
    violated: Bools
    score: Floats
