"""Estimates that are compared bit by bit, and killed again and again."""

import json

from avrare.testing.faulty_systems import Killed


def plain(result):
    """Return all that a result says except its seconds, with the bits of its arrays."""
    content = json.loads(result.to_json())
    del content["seconds"]
    failures = result.failures
    arrays = (failures.noise, failures.weights, result.robustness)
    return content, [None if array is None else array.tobytes() for array in arrays], result.artifacts


def estimate_through_kills(attempt):
    """Return the result of the first attempt that lives, and the number of those before that were killed."""
    for kills in range(1000):
        try:
            return attempt(kills), kills
        except Killed:
            continue
    raise AssertionError("no attempt goes on where the one before it was killed")
