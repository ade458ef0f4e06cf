"""Options of the simulator of recorded scenes."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self

from pydantic import ConfigDict, Field, ValidationError, field_validator, model_validator

from avrare.base.errors import UsageError, did_you_mean
from avrare.plugin import Options
from avrare.scenario.fingerprint import is_file
from avrare_single_track.config import AFTER_IMPACT, AfterImpact, EgoConfig, FollowingConfig


class HandedOverConfig(FollowingConfig[float]):
    """Recorded vehicles that a driver model takes over, from their state at the start.

    Each desires the highest speed that it was recorded with.
    """

    vehicles: tuple[int, ...] = Field(
        default=(),
        description="obstacles to take over; default: all that move and are along a lane at the start",
    )
    lane_changes: bool = Field(default=False, description="change lanes where it pays (MOBIL)")


def check_body(ego: dict[str, float], source: str) -> dict[str, float]:
    """Return options of the ego's body, without those of its start, which ``source`` gives.

    Raises:
        ValueError: One of them is not an option of a body, or has a wrong value.
    """
    for name in ego:
        if name in ("x", "y", "heading", "speed"):
            raise ValueError(f"ego.{name} is that of {source}: leave it out")
        if name not in EgoConfig.model_fields:
            hint = did_you_mean(name, EgoConfig.model_fields)
            raise ValueError(f"ego.{name}: unknown key" + (f"; {hint}" if hint else ""))
    try:
        EgoConfig(x=0.0, y=0.0, speed=0.0, **ego)
    except ValidationError as error:
        raise ValueError(_describe(error)) from None
    return ego


def check_ego(path: str, options: Mapping[str, Any]) -> EgoConfig:
    """Return the ego's options, those that a file gives among them.

    Raises:
        UsageError: A start or a size is beyond what the options allow.
    """
    try:
        return EgoConfig(**options)
    except ValidationError as error:
        raise UsageError(f"{path}: {_describe(error)}") from None


def _describe(error: ValidationError) -> str:
    first = error.errors()[0]
    where = ".".join(map(str, ("ego", *first["loc"])))
    return f"{where}: {first['msg'].removeprefix('Value error, ')}"


def _list_companions(file: Path) -> list[Path]:
    # Files that complete a recording of highD or inD, or a scene in CommonRoad's format 2024.
    companions: list[Path] = []
    if not is_file(file):
        return companions
    suffix = "_tracks.csv"
    if file.name.endswith(suffix):
        kinds = "tracksMeta", "recordingMeta"
        companions = [file.with_name(file.name.replace(suffix, f"_{kind}.csv")) for kind in kinds]
    elif file.suffix.lower() == ".pb":
        stem = file.stem.removesuffix("-SC")
        companions = [
            path
            for path in sorted(file.parent.glob("*.pb"))
            if stem.startswith(path.stem.removesuffix("-SC"))
        ]
    return [path for path in companions if path != file and is_file(path)]


class RecordedConfig(Options):
    """Options of the simulator ``commonroad``."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"file": "scene.xml"}]})

    file: Path = Field(
        description="CommonRoad scenario; with `vehicle` any recording with lanes, such as NN_tracks.csv of "
        "highD",
        json_schema_extra={"file": True},
    )
    problem: int | None = Field(default=None, description="id of the planning problem; default: the only one")
    vehicle: int | None = Field(
        default=None,
        description="recorded vehicle that the ego stands for, from its first step on, in place of a "
        "planning problem",
    )
    network: Path | None = Field(
        default=None,
        description="CommonRoad file with the lanes of a recording in the format of inD",
        json_schema_extra={"file": True},
    )
    dt: float | None = Field(
        default=None, ge=0.001, le=1.0, description="step [s]; default: that of the recording"
    )
    without: tuple[int, ...] = Field(
        default=(), description="obstacles to leave out, such as the one that the ego stands for"
    )
    route: tuple[int, ...] = Field(
        default=(),
        description="lanelets on the ego's way, such as that of a turn; default: straight on from its start",
    )
    ego: dict[str, float] = Field(
        default_factory=dict,
        description="body of the ego, as in single_track: length, width, wheelbase, friction, ...",
    )
    drivers: HandedOverConfig | None = Field(
        default=None, description="recorded vehicles that react; default: all repeat what was recorded"
    )

    after_impact: AfterImpact = Field(default="end", description=AFTER_IMPACT)

    def used_files(self) -> dict[str, Path]:
        """Files that lie beside the recording and complete it, which count in the fingerprint."""
        return {f"file.{number}": path for number, path in enumerate(_list_companions(self.file))}

    @field_validator("ego")
    @classmethod
    def _check_body(cls, ego: dict[str, float]) -> dict[str, float]:
        return check_body(ego, "the recording")

    @model_validator(mode="after")
    def _check_start(self) -> Self:
        wrong = ("problem", "route") if self.vehicle is not None else ("network",)
        for name in wrong:
            if getattr(self, name) not in (None, ()):
                text = "is of a planning problem" if self.vehicle is not None else "is of a `vehicle`"
                raise ValueError(f"{name} {text}: leave it out")
        return self
