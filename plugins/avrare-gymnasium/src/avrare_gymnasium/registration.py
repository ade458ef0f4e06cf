"""Environments that installed distributions register by entry points of the group ``gymnasium.envs``.

Gymnasium itself has not called them since its version 1.0. ``NAME = "module:function"`` registers ids of the
namespace ``NAME/``; ``__root__`` those without one.
"""

from __future__ import annotations

import functools
from importlib.metadata import EntryPoint, entry_points

from gymnasium.envs import registration


@functools.cache
def register_installed_environments() -> tuple[str, ...]:
    """Call the entry points of all installed distributions, once; return their errors, a line for each."""
    return tuple(line for point in entry_points(group="gymnasium.envs") if (line := _register(point)))


def _register(point: EntryPoint) -> str:
    try:
        registration.current_namespace = None if point.name == "__root__" else point.name
        register = point.load()  # importing a module may register its environments
        if callable(register):
            register()
    except (Exception, SystemExit) as error:
        origin = point.dist.name if point.dist is not None else point.value
        return f"{origin} could not register its environments: {type(error).__name__}: {error}"
    finally:
        registration.current_namespace = None
    return ""
