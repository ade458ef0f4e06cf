"""Checks of the diagnostics in a result file: those that readers rely on have the types that a run writes."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

_Count = Annotated[int, Field(ge=0)]
_ABSENT: Any = Field(default=None)
"""A part that may be missing, but is not null."""


class _Told(BaseModel):
    model_config = ConfigDict(strict=True, frozen=True)


class _Choice(_Told):
    counting_rollouts: _Count = _ABSENT
    shared_by: Annotated[int, Field(ge=1)] = _ABSENT


class _Model(_Told):
    members: list[Any]


class _Twin(_Told):
    counted: _Count = _ABSENT


class _Diagnostics(_Told):
    choice: _Choice = _ABSENT
    model: _Model = _ABSENT
    twin: _Twin = _ABSENT
    used_rollouts: _Count = _ABSENT


def check_diagnostics(found: dict[str, Any] | None) -> dict[str, Any] | None:
    """Return the diagnostics of an estimate, unchanged.

    Raises:
        ValueError: A part that readers rely on is damaged; the message says which.
    """
    try:
        _Diagnostics.model_validate(found or {})
    except ValidationError as error:
        first = error.errors()[0]
        reason = first["msg"].partition(" or instance of ")[0]  # a class of this module
        raise ValueError(f"{'.'.join(map(str, first['loc']))}: {reason}") from None
    return found
