"""Signal temporal logic: formulas as text, their robustness offline, and monitors."""

from avrare.logic.api import Formula, FormulaWarning, stl
from avrare.logic.explain import Explanation
from avrare.logic.intervals import IntervalMonitor, IntervalState, IntervalVerdict
from avrare.logic.online import FormulaMonitor, MonitorState

__all__ = [
    "Explanation",
    "Formula",
    "FormulaMonitor",
    "FormulaWarning",
    "IntervalMonitor",
    "IntervalState",
    "IntervalVerdict",
    "MonitorState",
    "stl",
]
