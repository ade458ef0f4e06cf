"""Codec of chunk outcomes: bytes of an ``.npz`` file with arrays and strings, never pickled objects."""

from __future__ import annotations

import hashlib
import io
from typing import Any

import numpy as np

from avrare.rollout.request import Request, Rollouts

_KEY, _SECONDS, _STEPS, _EVERY, _MESSAGES = "key", "seconds", "simulated_steps", "every", "messages"
_ARRAYS = ("robustness", "violated", "error", "scores", "log_weight")
_COUNT = "count."


def digest(chunk: Request) -> str:
    """Return 32 hexadecimal digits that identify the request of a chunk: addresses, starts, given noise."""
    hashed = hashlib.blake2b(digest_size=16)
    for values in (chunk.run, chunk.stage, chunk.particle, chunk.start):
        hashed.update(np.ascontiguousarray(values, dtype=np.int64).tobytes())
    if chunk.tape is not None:
        hashed.update(np.ascontiguousarray(chunk.tape).tobytes())
    hashed.update(f"{chunk.rows} {chunk.stop_early} {chunk.law is not None}".encode())
    return hashed.hexdigest()


def encode(outcome: Rollouts, key: str, seconds: float) -> bytes:
    """Encode an outcome without its carries.

    Args:
        outcome: Outcome of the chunk.
        key: Identity of the estimate and the chunk.
        seconds: Wall time of the estimate up to then [s].
    """
    arrays: dict[str, Any] = {name: getattr(outcome, name) for name in _ARRAYS}
    arrays |= {_COUNT + name: values for name, values in outcome.counts.items()}
    arrays |= {
        _KEY: np.array(key),
        _SECONDS: np.array(seconds),
        _STEPS: np.array(outcome.simulated_steps),
        _EVERY: np.array(outcome.every),
        _MESSAGES: np.array(outcome.messages, dtype=np.str_),
    }
    content = io.BytesIO()
    np.savez(content, **arrays)
    return content.getvalue()


def decode(content: bytes, key: str) -> tuple[Rollouts, float]:
    """Decode what ``encode`` returned: the outcome and the seconds.

    Raises:
        ValueError: The bytes are damaged, or belong to another estimate or chunk.
    """
    arrays = _arrays(content)
    try:
        outcome = Rollouts(
            **{name: arrays[name] for name in _ARRAYS},
            simulated_steps=int(arrays[_STEPS]),
            every=int(arrays[_EVERY]),
            counts={n.removeprefix(_COUNT): v for n, v in arrays.items() if n.startswith(_COUNT)},
            messages=tuple(str(text) for text in arrays[_MESSAGES]),
        )
        found, seconds = str(arrays[_KEY]), float(arrays[_SECONDS])
    except (ValueError, KeyError, TypeError) as error:
        raise ValueError(f"not an outcome of rollouts: {error}") from None
    if found != key:
        raise ValueError("belongs to another estimate")
    return outcome, seconds


def decode_seconds(content: bytes) -> float:
    """Decode only the seconds; 0 where they are missing.

    Raises:
        ValueError: The bytes are damaged.
    """
    arrays = _arrays(content)
    return float(arrays[_SECONDS]) if _SECONDS in arrays else 0.0


def _arrays(content: bytes) -> dict[str, Any]:
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as file:
            return {name: file[name] for name in file.files}
    except Exception as error:  # zipfile and NumPy raise many kinds of errors for a damaged file
        raise ValueError(f"damaged: {' '.join(str(error).split())}") from None
