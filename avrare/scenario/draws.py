"""Values of a simulator's draws: which options are drawn, by which laws, and how."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

KEY = "draws"
"""Key of a simulator's block with the settings of its draws."""


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Correlation(_Model):
    """Correlation of two drawn options."""

    between: tuple[str, str] = Field(description="the two drawn options, such as ego.speed")
    value: Annotated[float, Field(ge=-1.0, le=1.0)] = Field(
        description="correlation of their normal scores, in [-1, 1] (a Gaussian copula)"
    )


class DrawSettings(_Model):
    """Rules by which options are drawn, and for scenes that cannot be."""

    correlations: tuple[Correlation, ...] = Field(default=(), description="correlated pairs of options")
    overlap: Literal["resample", "error"] = Field(
        default="resample",
        description="vehicles that overlap at the start: draw the scene again, or count the rollout as an "
        "error",
    )
    broken_rule: Literal["resample", "error", "keep"] = Field(
        default="resample",
        description="a specification violated at the start: draw the scene again, count the rollout as an "
        "error, or keep it as a failure",
    )
    attempts: int = Field(
        default=100, ge=1, le=10_000, description="draws of one scene; if all are impossible it is an error"
    )


@dataclass(frozen=True)
class Draws:
    """Drawn options of a simulator, K of them, sorted by their places.

    Attributes:
        paths: Place of each in the simulator's options, such as ``vehicles.0.speed``.
        names: The same for people: an item of a list by its own name, ``vehicles.cut_in.speed``.
        laws: Law of each.
        settings: Correlations, and what becomes of impossible scenes.
    """

    paths: tuple[str, ...]
    names: tuple[str, ...]
    laws: tuple[Any, ...]
    settings: DrawSettings

    @property
    def correlation(self) -> NDArray[np.float64]:
        """Correlation matrix (K, K) of the normal scores."""
        return correlation_matrix(self.names, self.settings.correlations)

    def write_into(self, options: dict[str, Any]) -> None:
        """Put the laws into plain options, in the places of their medians."""
        for path, law in zip(self.paths, self.laws, strict=True):
            place, key = _find(options, path.split("."))
            place[key] = law.model_dump(mode="json")
        options[KEY] = self.settings.model_dump(mode="json")


def _find(place: Any, way: Sequence[str]) -> tuple[Any, Any]:
    # The container and the key of a path; a key may have dots of its own, or be a number as text
    key: int | str
    if isinstance(place, list):
        key, used = int(way[0]), 1
    else:
        used = next(n for n in range(1, len(way) + 1) if ".".join(way[:n]) in place)
        key = ".".join(way[:used])
    return (place, key) if used == len(way) else _find(place[key], way[used:])


def correlation_matrix(names: Sequence[str], correlations: Sequence[Correlation]) -> NDArray[np.float64]:
    """Return the correlation matrix (K, K) of options with these names."""
    matrix = np.eye(len(names))
    for pair in correlations:
        one, other = (list(names).index(name) for name in pair.between)
        matrix[one, other] = matrix[other, one] = pair.value
    return matrix
