"""Values that make the page: what a renderer is handed, and can be stored as JSON.

Sentences are complete; numbers, charts and drives are drawn by the renderer.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Self

from pydantic import JsonValue, TypeAdapter

from avrare.base.chart import Chart, Points, Scale


@dataclass(frozen=True)
class Limit:
    """Threshold on a probability."""

    strict: bool
    limit: float


@dataclass(frozen=True)
class Estimate:
    """Numbers of one specification, its warnings by name, and its notes; a rollout lasts ``duration`` [s]."""

    specification: str
    verdict: str | None
    probability: float
    interval: tuple[float, float]
    confidence: float
    relative_error: float | None
    rollouts: int
    counts: tuple[tuple[str, int], ...]
    seconds: float
    limits: tuple[Limit, ...]
    warnings: tuple[tuple[str, str], ...]
    notes: tuple[str, ...]
    blind_bound: float | None
    duration: float | None


@dataclass(frozen=True)
class Answer:
    """Sentence on how often a specification is broken, and why; ``index`` is that of its section."""

    index: int
    sentence: str
    rates: tuple[str, ...]
    reasons: tuple[str, ...]


@dataclass(frozen=True)
class Summary:
    """First lines: the overall verdict, one line for each specification, the worst first.

    ``example`` is a line for the scenario that would give a verdict; empty where there is one.
    """

    verdict: str | None
    lead: str
    example: str
    answers: tuple[Answer, ...]
    exposure: str


@dataclass(frozen=True)
class Notice:
    """Something that the page cannot show, with the lines that say why."""

    text: str
    lines: tuple[str, ...] = ()


@dataclass(frozen=True)
class Rule:
    """Specification in words and as a formula; either may be empty."""

    words: str
    formula: str


@dataclass(frozen=True)
class Command:
    """Command beside its output; ``text`` is its purpose."""

    title: str
    text: str
    command: str


@dataclass(frozen=True)
class Car:
    """Vehicle in a picture from above [m], y downwards; ``turn`` in degrees."""

    name: str
    style: str
    x: float
    y: float
    turn: float
    length: float
    width: float
    trail: Points


@dataclass(frozen=True)
class Picture:
    """Moment of a drive from above: lanes, lines between them, vehicles; ``view`` is x, y, width, height."""

    title: str
    view: tuple[float, float, float, float]
    lanes: tuple[Points, ...]
    lines: tuple[Points, ...]
    cars: tuple[Car, ...]


@dataclass(frozen=True)
class Kind:
    """Kind of failure; ``anchor`` is that of its most typical one, empty where it is not shown."""

    number: int
    style: int
    probability: float
    interval: tuple[float, float]
    share: str
    text: str
    representative: int
    anchor: str
    sentences: tuple[str, ...]
    warnings: tuple[str, ...]
    picture: Picture | None


@dataclass(frozen=True)
class Kinds:
    """Kinds of failure of one specification and all failures in a plane."""

    kinds: tuple[Kind, ...]
    map: Chart | None


@dataclass(frozen=True)
class Causes:
    """Causes of failure; without an analysis its command alone. ``problem`` says why none can be read.

    ``savings`` are changes, each with words for its effect on the failures.
    """

    problem: str = ""
    kinds: Kinds | None = None
    savings: tuple[tuple[str, str], ...] = ()
    command: Command | None = None


@dataclass(frozen=True)
class Strip:
    """Row of coloured pixels: signed shares of full colour (rows, columns), -1 to 1, 0 for none.

    The smallest share other than zero has the opacity ``least``; ``height`` is in pixels.
    """

    label: str
    description: str
    shares: tuple[tuple[float, ...], ...]
    least: float
    height: int


@dataclass(frozen=True)
class Strips:
    """Strips below each other on the clock of a player."""

    caption: str
    strips: tuple[Strip, ...]
    legend: tuple[tuple[str, str], ...]
    note: str


@dataclass(frozen=True)
class Player:
    """Stored rollout, replayed: an animation, charts on the same clock, predicates, noise.

    Attributes:
        title: Why it is shown.
        text: Its robustness and noise.
        anchor: Name to link to; empty for a rollout that passes.
        problem: Reason why it cannot be shown; the other fields are then empty.
        sentence: What the monitor says.
        severity: How severe it is.
        lost: When it was lost.
        difference: How its replay differs from the stored one.
        drawn: Values drawn at the start, by name.
        start: Sample at which it opens.
        samples: Number of samples.
        clock: Time at which it opens [s].
        top_view: Description of the view from above; empty without vehicles.
        view: What the script of the page draws, by the names that it reads.
        signals: Charts in place of the view from above.
        charts: Charts beside it.
        marks: Legend of the moments marked in them.
        robustness: Chart of the robustness.
        predicates: Strips of the predicates.
        noise: Strips of the noise.
        command: Command that replays it.
    """

    title: str
    text: str
    anchor: str
    problem: str = ""
    sentence: str = ""
    severity: str = ""
    lost: str = ""
    difference: str = ""
    drawn: tuple[tuple[str, str], ...] = ()
    start: int = 0
    samples: int = 0
    clock: float = 0.0
    top_view: str = ""
    view: JsonValue = None
    signals: tuple[Chart, ...] = ()
    charts: tuple[Chart, ...] = ()
    marks: tuple[tuple[str, str], ...] = ()
    robustness: Chart | None = None
    predicates: Strips | None = None
    noise: Strips | None = None
    command: str = ""


@dataclass(frozen=True)
class Section:
    """Everything about one specification; ``absence`` says why no rollout is shown."""

    estimate: Estimate
    rule: Rule | None
    causes: Causes | None
    charts: tuple[Chart, ...]
    players: tuple[Player, ...]
    absence: Notice | None


@dataclass(frozen=True)
class Origin:
    """Origin of the numbers; a fact is its name, its value, and whether that is code."""

    reproduction: str
    original: str
    report_command: str
    facts: tuple[tuple[str, str, bool], ...]
    scenario: str


class StoredModel:
    """Model of a page, which can be stored."""

    def to_json(self) -> str:
        """Return the model as JSON text."""
        return json.dumps(TypeAdapter(type(self)).dump_python(self))

    @classmethod
    def from_json(cls, text: str) -> Self:
        """Return the model that ``to_json`` has written.

        Raises:
            ValueError: The text is of something else.
        """
        return TypeAdapter(cls).validate_json(text)


@dataclass(frozen=True)
class ReportModel(StoredModel):
    """Everything that the page of a run shows.

    Attributes:
        name: Name of the run.
        version: Version of avrare that made the run.
        description: What the scenario says of itself.
        facts: Facts below the title.
        summary: First lines.
        axis: Common axis of the intervals.
        notices: What cannot be shown, or may not be what was run.
        sections: A section for each specification.
        origin: How the numbers were made.
    """

    name: str
    version: str
    description: str
    facts: tuple[str, ...]
    summary: Summary
    axis: Scale
    notices: tuple[Notice, ...]
    sections: tuple[Section, ...]
    origin: Origin
