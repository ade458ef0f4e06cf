"""Compilation by numba where it is installed; the same functions in plain Python where it is not."""

from __future__ import annotations

import contextlib
import hashlib
import pickle
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TypeVar

numba: Any
try:
    import numba
except ImportError:
    numba = None

Function = TypeVar("Function", bound=Callable[..., object])

COMPILED = numba is not None and not numba.config.DISABLE_JIT
"""True where the kernels are compiled."""
_OPTIONS: dict[str, Any] = {"error_model": "numpy", "nogil": True}
_FOLDER = Path(__file__).parent
_SOURCES = {__file__, str(_FOLDER / "lanes.py"), str(_FOLDER / "vectors.py")}
"""Source files of the kernels, and those that define their building blocks."""
if COMPILED:
    import avrare_mpc.riccati.vectors  # noqa: F401  (compiled code knows lanes from now on)


def kernel(function: Function) -> Function:
    """Compile a function that other kernels call, inline: a call would cost as much as most bodies.

    Arithmetic is strictly IEEE, so that every run has the same bits.
    """
    _SOURCES.add(function.__code__.co_filename)
    return inline(function)


def inline(function: Function) -> Function:
    """Compile a function like ``kernel``, for an entry in the same file, whose cache knows of its changes."""
    return numba.njit(forceinline=True, **_OPTIONS)(function) if COMPILED else function


def entry(function: Function) -> Function:
    """Compile a function that Python calls; its machine code is cached on disk for the next process."""
    if not COMPILED:
        return function
    try:
        return _Entry(function)  # type: ignore[return-value]
    except RuntimeError:  # neither the package nor the user's cache folder is writable
        compiled: Function = numba.njit(**_OPTIONS)(function)
        return compiled


class _Entry:
    """Function with machine code on disk, recompiled where the file is truncated (loss of power).

    Attributes:
        compiled: numba's dispatcher.
    """

    def __init__(self, function: Callable[..., object]) -> None:
        self._function = function
        self.compiled = numba.njit(cache=True, **_OPTIONS)(function)

    def __call__(self, *arguments: object) -> Any:
        try:
            return self.compiled(*arguments)
        except (EOFError, pickle.UnpicklingError):
            self._recompile()
            return self.compiled(*arguments)

    def _recompile(self) -> None:
        module = Path(self._function.__code__.co_filename).stem
        for file in Path(self.compiled.stats.cache_path).glob(f"{module}.*.nb[ci]"):
            file.unlink(missing_ok=True)
        self.compiled = numba.njit(cache=True, **_OPTIONS)(self._function)


@contextlib.contextmanager
def announce(message: str) -> Iterator[None]:
    """Print a message to standard error once a kernel is compiled in this block."""
    if not COMPILED:
        yield
        return
    from numba.core import event

    class Announcement(event.Listener):
        announced = False

        def on_start(self, event: event.Event) -> None:
            if not self.announced:
                print(message, file=sys.stderr, flush=True)
                self.announced = True

        def on_end(self, event: event.Event) -> None:
            pass

    with event.install_listener("numba:compile", Announcement()):
        yield


def sources_digest() -> str:
    """Return the digest of the kernel sources so far; numba only checks the file of the entry."""
    digest = hashlib.sha256()
    for name in sorted(_SOURCES):
        digest.update(Path(name).read_bytes())
    return digest.hexdigest()
