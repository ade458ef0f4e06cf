"""Options of a program, and its answer to ``hello``."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BeforeValidator, ConfigDict, Field, JsonValue, field_validator

from avrare.plugin import Options
from avrare.scenario.safe_mode import TRUST, is_safe

EXAMPLE = Path(__file__).with_name("examples") / "acc.py"
"""Program in plain Python: adaptive cruise control, as simulator and as controller."""


def _convert_to_tuple(value: object) -> object:
    """Convert a list to a tuple, since strict validation refuses lists."""
    return tuple(value) if isinstance(value, list) else value


Words = Annotated[tuple[str, ...], BeforeValidator(_convert_to_tuple)]


class ProcessConfig(Options):
    """Program, and the options that it gets."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"command": [sys.executable, str(EXAMPLE)]}]})

    command: Words = Field(min_length=1, description="program and its arguments; it is run")
    options: Mapping[str, JsonValue] = Field({}, description="values that it gets in `hello`, by name")
    connect: Literal["stdio", "socket"] = Field(
        "stdio",
        description="stdio: messages on its standard input and output; socket: on a connection to the port "
        "of 127.0.0.1 in its environment variable AVRARE_PORT",
    )
    timeout: float = Field(
        60.0, gt=0.0, le=86400.0, description="limit of an answer [s]; a later one is an error of the rollout"
    )

    start_timeout: float = Field(
        60.0, gt=0.0, le=86400.0, description="limit of its start, the answer to `hello` included [s]"
    )

    @field_validator("command")
    @classmethod
    def _check_trust(cls, command: tuple[str, ...]) -> tuple[str, ...]:
        if is_safe():
            raise ValueError(f"safe mode: a program is code of no installed plugin; {TRUST}")
        return command

    def used_files(self) -> dict[str, Path]:
        """Return the words of the command that name files."""
        files = {f"command.{i}": Path(word) for i, word in enumerate(self.command)}
        return {name: path for name, path in files.items() if path.is_file()}


class Hello(Options):
    """Answer to ``hello``.

    Attributes:
        outputs: Names of the numbers of an answer: a simulator's signals, a controller's action.
        seen: Names of further numbers, which a controller sees in place of the signals.
        noise: Name of each noise number.
        dt: Time of a step [s].
        copy_: The program knows ``copy``.
        memory: False: an output depends on the input alone, and ``reset`` is missing.
    """

    outputs: Words = Field(min_length=1)
    seen: Words = ()
    noise: Words = ()
    dt: float = Field(1.0, gt=0.0)
    copy_: bool = Field(False, alias="copy")
    memory: bool = True
