"""Compilation by numba where it is installed; the same functions in plain Python where it is not."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

numba: Any
try:
    import numba
except ImportError:
    numba = None

Function = TypeVar("Function", bound=Callable[..., Any])

COMPILED = numba is not None and not numba.config.DISABLE_JIT
"""Whether the kernels are compiled."""
_OPTIONS: dict[str, Any] = {"error_model": "numpy", "nogil": True}
_SOURCES = {__file__}
"""Files of the kernels, and this one for the options."""


def kernel(function: Function) -> Function:
    """A function that other kernels call, merged into them: a call would cost as much as most bodies.

    Arithmetic is strictly IEEE, so that every run rounds alike.
    """
    _SOURCES.add(function.__code__.co_filename)
    return numba.njit(forceinline=True, **_OPTIONS)(function) if COMPILED else function


def entry(function: Function) -> Function:
    """The function that Python calls: its machine code is kept on disk for the next process."""
    if not COMPILED:
        return function
    try:
        return numba.njit(cache=True, **_OPTIONS)(function)  # type: ignore[no-any-return]
    except RuntimeError:  # neither the package nor the user's cache folder can be written to
        return numba.njit(**_OPTIONS)(function)  # type: ignore[no-any-return]


def sources_digest() -> str:
    """Digest of the kernels' sources so far: numba would only notice changes of the entry's own file."""
    digest = hashlib.sha256()
    for name in sorted(_SOURCES):
        digest.update(Path(name).read_bytes())
    return digest.hexdigest()
