"""Signal temporal logic: formulas as text, their robustness on traces, and monitors."""

from avrare.logic.explanation import Explanation
from avrare.logic.formula import Formula, FormulaMonitor, FormulaWarning, stl
from avrare.logic.monitor.monitors import IntervalMonitor, IntervalState, IntervalVerdict, MonitorState

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
