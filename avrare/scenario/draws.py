"""Drawn options of a simulator: laws in the place of numbers, as the YAML file has them."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal, Self, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    ValidationInfo,
    field_validator,
    model_validator,
)

from avrare.base.csv_table import read_csv_table
from avrare.base.errors import UsageError, did_you_mean
from avrare.base.laws import Law, condense
from avrare.scenario.safe_mode import refuse_outside
from avrare.scenario.validation import Mistake, Place, check, error_with_hint, find_places
from avrare.scenario.value_positions import Node, Path, join_path

KEY = "draws"
"""Key of a simulator's block with the settings of its draws."""
TAIL = 6.0
"""Normal score at which draws are checked against the bounds of their option: 1e-9 lies beyond."""

Model = TypeVar("Model", bound=BaseModel)


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


def _check_name(name: str, info: ValidationInfo) -> str:
    if info.context is not None and name not in info.context:
        raise error_with_hint(f"no drawn option is called {name!r}", did_you_mean(name, info.context))
    return name


_Name = Annotated[str, AfterValidator(_check_name)]


class Correlation(_Model):
    """Correlation of two drawn options."""

    between: tuple[_Name, _Name] = Field(description="the two drawn options, such as ego.speed")
    value: Annotated[float, Field(ge=-1.0, le=1.0)] = Field(
        description="correlation of their normal scores, in [-1, 1] (a Gaussian copula)"
    )

    @model_validator(mode="after")
    def _check_ends(self) -> Self:
        if self.between[0] == self.between[1]:
            raise ValueError("these are one and the same")
        return self


class DrawSettings(_Model):
    """Rules for drawing options, and for impossible scenes.

    The validators know the names of the drawn options by their context.
    """

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

    @field_validator("correlations")
    @classmethod
    def _check_agreement(
        cls, correlations: tuple[Correlation, ...], info: ValidationInfo
    ) -> tuple[Correlation, ...]:
        if info.context is not None:
            matrix = correlation_matrix(info.context, correlations)
            if np.linalg.eigvalsh(matrix).min() < -1e-9:
                raise error_with_hint(
                    "these correlations contradict each other", "bring them nearer to 0, or leave one out"
                )
        return correlations


@dataclass(frozen=True)
class Draws:
    """Drawn options of a simulator, K of them, sorted by their places.

    Attributes:
        places: Keys that lead to each in the simulator's options.
        names: The same for people: an item of a list by its own name, ``vehicles.cut_in.speed``.
        laws: Law of each.
        settings: Correlations, and the treatment of impossible scenes.
    """

    places: tuple[Path, ...]
    names: tuple[str, ...]
    laws: tuple[Law, ...]
    settings: DrawSettings

    @property
    def paths(self) -> tuple[str, ...]:
        """Places as a simulator gets them, such as ``vehicles.0.speed``."""
        return tuple(".".join(map(str, place)) for place in self.places)

    @property
    def correlation(self) -> NDArray[np.float64]:
        """Correlation matrix (K, K) of the normal scores."""
        return correlation_matrix(self.names, self.settings.correlations)

    def write_into(self, options: dict[str, object]) -> None:
        """Put the laws into plain options, in the places of their medians."""
        for place, law in zip(self.places, self.laws, strict=True):
            container: Any = options
            for step in place[:-1]:
                container = container[step]
            container[place[-1]] = law.model_dump(mode="json")
        options[KEY] = self.settings.model_dump(mode="json")


def correlation_matrix(names: Sequence[str], correlations: Sequence[Correlation]) -> NDArray[np.float64]:
    """Return the correlation matrix (K, K) of options with these names."""
    matrix = np.eye(len(names))
    for pair in correlations:
        first, second = (list(names).index(name) for name in pair.between)
        matrix[first, second] = matrix[second, first] = pair.value
    return matrix


def check_drawn(
    model: type[Model], node: Node, path: Path, folder: str
) -> tuple[Model | None, Draws | None, list[Mistake]]:
    """Validate the block of a simulator, in which laws may stand in the place of numbers.

    The model sees the median of every law; then, for one law at a time, a value far out in either tail,
    which must keep the model's bounds as well.

    Args:
        model: Model of the simulator's options.
        node: The block as written.
        path: Keys that lead to it.
        folder: Folder of the scenario, which safe mode does not leave.
    """
    keys = ("plugin", KEY)
    places = find_places(model, node)
    # Sorted, so that the order in which a file names its options is of no account.
    drawn = sorted((at for at, place in places.items() if place.has_law), key=lambda at: [*map(str, at)])
    laws, mistakes = _read_laws({at: places[at].node for at in drawn}, path, folder)
    names = tuple(_name_option(places, at) for at in drawn)
    settings: DrawSettings | None = DrawSettings()
    if (written := node.child(KEY)) is not None:
        settings, new_mistakes = check(
            DrawSettings, written, (*path, KEY), context=None if mistakes or not drawn else names
        )
        mistakes += new_mistakes
        if settings is not None and not drawn:
            hint = "write a law in place of a number, such as {law: normal, mean: 20.0, sd: 1.0}"
            text = "no option of this simulator is drawn"
            mistakes.append(Mistake(written.name_mark, (*path, KEY), text, hint))
    medians = {at: float(law.at(0.0)) for at, law in laws.items()}
    config, new_mistakes = check(model, node, path, keys, numbers=medians)
    wrong_laws = [(*path, *at) for at in drawn if at not in laws]
    mistakes += [mistake for mistake in new_mistakes if mistake.path not in wrong_laws]
    if config is None or settings is None or mistakes:
        return None, None, mistakes
    for at, law in laws.items():
        for value in (float(law.at(-TAIL)), float(law.at(TAIL))):
            _, new_mistakes = check(model, node, path, keys, numbers={**medians, at: value})
            if new_mistakes:
                text = f"draws reach {value:.4g}: {new_mistakes[0].text.partition(', found')[0]}"
                hint = "cut the law: {law: truncated, of: {...}, low: ..., high: ...}"
                mistakes.append(Mistake(places[at].node.mark, (*path, *at), text, hint))
    draws = Draws(tuple(drawn), names, tuple(laws.values()), settings) if drawn else None
    return config, draws, mistakes


def _read_laws(nodes: Mapping[Path, Node], path: Path, folder: str) -> tuple[dict[Path, Law], list[Mistake]]:
    laws: dict[Path, Law] = {}
    mistakes: list[Mistake] = []
    for at, node in nodes.items():
        try:
            named = Node({join_path(at): _with_columns(node, folder)}, node.mark)
        except UsageError as error:
            mistakes.append(Mistake(node.mark, (*path, *at), error.message, error.hint))
            continue
        law, new_mistakes = check(dict[str, Law], named, path)
        mistakes += new_mistakes
        if law is not None:
            [laws[at]] = law.values()
    return laws, mistakes


def _with_columns(node: Node, folder: str) -> Node:
    # Columns of CSV files become the values themselves: a run is then complete without the file.
    entries = {key: _with_columns(child, folder) for key, child in node.entries.items()}
    items = [_with_columns(child, folder) for child in node.items]
    if entries.get("law", node).value != "empirical" or "file" not in entries:
        return Node(entries or items or node.value, node.mark, node.key)
    if "values" in entries:
        raise UsageError("give values or a file, not both")
    file, column = str(entries.pop("file").value), entries.pop("column", None)
    directory = os.path.dirname(node.mark.file) if node.mark.line else folder
    name = os.path.normpath(os.path.join(directory, file))
    refuse_outside(name, folder, "empirical law: file")
    table = read_csv_table(name)
    table.check_rows()
    if column is None or str(column.value) not in table.names:
        word = "" if column is None else str(column.value)
        text = f"{file} has no column {word!r}" if word else "give the column of the file"
        raise UsageError(text, did_you_mean(word, table.names))
    numbers = [table.finite(row, str(column.value)) for row in range(len(table.rows))]
    values = Node.of(condense(np.array(numbers)).tolist(), node.mark)
    return Node({**entries, "values": values}, node.mark, node.key)


def _name_option(places: Mapping[Path, Place], at: Path) -> str:
    words = []
    for depth, step in enumerate(at, start=1):
        name = places[at[:depth]].node.child("name") if isinstance(step, int) else None
        words.append(str(step if name is None else name.value))
    return ".".join(words)
