"""Requests of rollouts, as executors get them."""

import numpy as np

from avrare.rollout.request import Request


def fresh(rows, **keywords):
    """Return a request of the first rollouts."""
    return Request.from_start(np.zeros(rows, dtype=np.int64), np.arange(rows), **keywords)


def cut(rows, size):
    """Return the first rollouts in chunks."""
    return [fresh(rows).slice(at, at + size) for at in range(0, rows, size)]
