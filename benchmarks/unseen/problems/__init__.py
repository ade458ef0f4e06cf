"""The problems: static ones, continuous ones, those of planners and those of discrete states."""

from . import continuous, discrete, exact, planners, static
from .case import CASES, Case

__all__ = ["CASES", "Case", "continuous", "discrete", "exact", "planners", "static"]
