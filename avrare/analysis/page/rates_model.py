"""Values that make the page of a catalogue's rates; see ``model``."""

from __future__ import annotations

from dataclasses import dataclass

from avrare.analysis.page.model import StoredModel
from avrare.base.chart import Scale


@dataclass(frozen=True)
class Rate:
    """Rate of a rule in one unit, with its intervals; ``verdicts`` have the words of their thresholds.

    ``driver`` is the controller that drove in place of the stack's, empty for the stack.
    """

    rule: str
    driver: str
    unit: str
    value: float
    interval: tuple[float, float]
    sampling: tuple[float, float]
    exposure: tuple[float, float]
    verdicts: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Table:
    """Section of one table: its heads, and the cells of each row, as text.

    ``words`` are the columns of words, which are not set as numbers; ``lines`` stand below it.
    """

    title: str
    text: str
    heads: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    words: tuple[int, ...] = ()
    lines: tuple[str, ...] = ()


@dataclass(frozen=True)
class RatesModel(StoredModel):
    """Everything that the page of a catalogue's rates shows.

    Attributes:
        name: Name of the catalogue.
        description: What it says of itself.
        facts: Facts below the title.
        answers: Sentences on the risk balance; empty without another driver.
        notices: Scenes with too many errors, and warned estimates: the lines of each.
        axes: Axis of the intervals of each unit.
        rates: Rates of the rules.
        tables: Scenes of each rule, estimates with intervals of their own, and all scenes.
    """

    name: str
    description: str
    facts: tuple[str, ...]
    answers: tuple[str, ...]
    notices: tuple[tuple[str, ...], ...]
    axes: dict[str, Scale]
    rates: tuple[Rate, ...]
    tables: tuple[Table, ...]
