"""What a plugin finds wrong with the options of one of its components before anything is built."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Finding:
    """One mistake or doubt.

    Attributes:
        message: What is wrong; several lines where a formula is shown with a mark.
        hint: What to do about it.
        option: The option that it is about; None: the component as a whole.
        is_error: Whether the scenario cannot be used; else it is a warning.
    """

    message: str
    hint: str | None = None
    option: str | None = None
    is_error: bool = True
