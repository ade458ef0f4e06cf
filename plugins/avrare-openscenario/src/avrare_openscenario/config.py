"""Options of the simulator of OpenSCENARIO files."""

from __future__ import annotations

from pathlib import Path

from pydantic import ConfigDict, Field, field_validator

from avrare.plugin import Drawable, Options
from avrare_single_track.config import AFTER_IMPACT, AfterImpact
from avrare_single_track.file_config import check_body


class OpenScenarioConfig(Options):
    """Options of the simulator ``openscenario``."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"file": "cut_in.xosc", "entity": "Ego"}]})

    file: Path = Field(
        description="OpenSCENARIO XML 1.x: a scenario, or a file of parameter distributions that names one",
        json_schema_extra={"file": True},
    )
    entity: str = Field(default="Ego", min_length=1, description="name of the entity that is the ego")
    road: Path | None = Field(
        default=None,
        description="OpenDRIVE or CommonRoad file; default: the one that the scenario names",
        json_schema_extra={"file": True},
    )
    catalogs: tuple[Path, ...] = Field(
        default=(),
        max_length=100,
        description="files of catalogs; default: those that the scenario refers to",
    )
    dt: float = Field(default=0.1, gt=0.0, le=1.0, description="step [s]")
    parameters: dict[str, Drawable | str] = Field(
        default_factory=dict, description="values or laws of parameters, in place of those that are declared"
    )
    ego: dict[str, float] = Field(
        default_factory=dict,
        description="limits of the ego, as in single_track: friction, acceleration_max, steering_max, ...",
    )
    ignore_ego_events: bool = Field(
        default=False, description="pass over what the storyboard has the ego do; its start counts"
    )
    weather: Drawable | None = Field(
        default=None, gt=0.0, description="factor on the errors of perception and on the odds of a miss"
    )

    after_impact: AfterImpact = Field(default="end", description=AFTER_IMPACT)

    def used_files(self) -> dict[str, Path]:
        """Files of catalogs, which count in the fingerprint."""
        return {f"catalogs.{number}": path for number, path in enumerate(self.catalogs)}

    @field_validator("ego")
    @classmethod
    def _check_body(cls, ego: dict[str, float]) -> dict[str, float]:
        return check_body(ego, "the file")
