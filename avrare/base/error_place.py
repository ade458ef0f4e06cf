"""Place at which an exception arose, for messages without a traceback."""

from __future__ import annotations

import traceback


def find_place(error: BaseException) -> str:
    """Return ``file:line in function`` of the last frame; of a file that cannot be read, file and line."""
    if isinstance(error, SyntaxError) and error.filename:
        return f"{error.filename}:{error.lineno}"
    frames = traceback.extract_tb(error.__traceback__)
    if not frames:
        return "unknown place"
    return f"{frames[-1].filename}:{frames[-1].lineno} in {frames[-1].name}"
