"""Parts of a loop that do not fit together: an output of one that the other cannot use."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from avrare.base.errors import AvrareError, PluginError, find_place
from avrare.stack.closed_loop import ClosedLoop, LoopState


@contextmanager
def explain_misfits(path: str, loop: ClosedLoop, state: LoopState) -> Iterator[None]:
    """Turn an exception of a step from ``state`` into a ``PluginError`` that names the part and its input."""
    try:
        yield
    except (AvrareError, MemoryError):
        raise
    except (Exception, SystemExit) as error:
        part, hint = _find_part(loop, state)
        text = f"{path}: the {part} breaks down in its first steps: {type(error).__name__}: {error}"
        raise PluginError(f"{text} ({find_place(error)})", hint) from error


def _find_part(loop: ClosedLoop, state: LoopState) -> tuple[str, str]:
    if loop.controller is None:
        return "stack", "its simulator gets the action None: if it needs another, add a `controller:`"
    try:
        action, _ = loop.act(state)
    except (Exception, SystemExit):
        seen = _describe(loop.show(state.world))
        if not hasattr(state.world, "ego"):
            names = ", ".join(loop.simulator.signals(state.world))
            seen += f", the signals {names}: give the simulator's state an attribute `ego` to show it another"
        return "controller", f"it sees {seen}"
    return "stack", f"its simulator gets the controller's action, {_describe(action)}"


def _describe(value: object) -> str:
    if isinstance(value, np.ndarray):
        return f"an array {value.shape} for N = {len(value)}" if value.ndim else "an array without rows"
    members = ", ".join(vars(value)) if hasattr(value, "__dict__") else ""
    return f"a {type(value).__name__}" + (f" with {members}" if members else "")
