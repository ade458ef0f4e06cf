"""Options of the controller ``policy``."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import Field

from avrare.plugin import Options


class PolicyConfig(Options):
    """Model file of a learnt policy."""

    model: str = Field(
        min_length=1,
        description="name of a policy that an installed plugin ships, or the path of an .npz or .onnx file",
        json_schema_extra={"file": True},
    )
    arrays: dict[str, Any] | None = Field(
        default=None,
        description="weights and biases in place of those of an .npz file, by name: W0, b0, W1, ...",
    )
    gain: tuple[float, ...] | None = Field(
        default=None,
        description="factors on the outputs of an .npz file's network, before they are clipped; default: 1",
    )
    output: Literal["value", "argmax"] = Field(
        "value", description="argmax: the action is the number of the largest output (discrete actions)"
    )
