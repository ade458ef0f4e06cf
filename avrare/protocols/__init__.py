"""Contracts between the parts of avrare: base classes with documented defaults, and their adapter."""

from avrare.protocols.adapter import BASES, Adapted, SystemWrapper, adapt, list_missing_members, overrides
from avrare.protocols.kinds import (
    Controller,
    Estimator,
    Executor,
    PerceptionErrorModel,
    Simulator,
    Specification,
    System,
    Tracker,
)
from avrare.protocols.values import Bools, Floats, Misreading, Signals, Verdict

__all__ = [
    "BASES",
    "Adapted",
    "Bools",
    "Controller",
    "Estimator",
    "Executor",
    "Floats",
    "Misreading",
    "PerceptionErrorModel",
    "Signals",
    "Simulator",
    "Specification",
    "System",
    "SystemWrapper",
    "Tracker",
    "Verdict",
    "adapt",
    "list_missing_members",
    "overrides",
]
