"""Mark of options that a scenario may draw at random in place of a number.

A simulator that draws the option ``x`` writes ``x: Drawable = Field(...)`` in its model. The model itself
only ever sees numbers: drawn values reach the simulator's ``reset_drawn`` (``avrare.stack.drawn_start``).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, TypeAlias, get_args

from pydantic import GetJsonSchemaHandler
from pydantic.fields import FieldInfo

LAW_NAMES = ("normal", "lognormal", "uniform", "truncated", "mixture", "empirical", "discrete")
"""Names of the laws in ``avrare.base.laws``, which this module does not import: it needs NumPy."""


@dataclass(frozen=True)
class DrawableMark:
    """Mark of one option, and its part of the JSON schema: a number, or a mapping with a law."""

    def __get_pydantic_json_schema__(self, core: Any, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        """Return the schema of the number or of a law."""
        law = {
            "type": "object",
            "required": ["law"],
            "properties": {"law": {"enum": list(LAW_NAMES)}},
            "description": "law of a number that is drawn at the start of every rollout",
        }
        return {"anyOf": [handler(core), law]}


Drawable: TypeAlias = Annotated[float, DrawableMark()]
"""Number that a scenario may draw."""


def is_drawable(field: FieldInfo) -> bool:
    """Return whether a field of a model, or a member of its union, bears the mark."""
    return any(isinstance(one, DrawableMark) for one in field.metadata) or _marked(field.annotation)


def _marked(annotation: Any) -> bool:
    arguments = get_args(annotation)
    return any(isinstance(one, DrawableMark) or _marked(one) for one in arguments)
