"""Signal temporal logic: formulas as text, their robustness offline, and monitors."""

from avrare.logic.api import Formula, stl
from avrare.logic.online import FormulaMonitor, MonitorState

__all__ = ["Formula", "FormulaMonitor", "MonitorState", "stl"]
