"""Signal temporal logic: formulas as text, their robustness offline, and monitors."""

import sys
from fractions import Fraction
from types import ModuleType

from avrare.stl.api import Formula, stl
from avrare.stl.online import FormulaMonitor, MonitorState

__all__ = ["Formula", "FormulaMonitor", "MonitorState", "stl"]


class _Callable(ModuleType):
    """Importing any module of this package binds ``avrare.stl`` to it, and ``avrare.stl(...)`` is public."""

    def __call__(self, text: str, dt: float | Fraction = 1.0, until: str = "closed") -> Formula:
        return stl(text, dt, until)


sys.modules[__name__].__class__ = _Callable
