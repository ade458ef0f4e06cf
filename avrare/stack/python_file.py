"""Parts from a Python file: a class as simulator or controller, without a package."""

from __future__ import annotations

import inspect
import sys
import zlib
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any, cast

from pydantic import ConfigDict, Field, JsonValue, field_validator

from avrare.base.errors import UsageError, did_you_mean
from avrare.driving import Scene
from avrare.plugin import Options
from avrare.scenario.safe_mode import TRUST, is_safe
from avrare.worlds import Worlds

TEMPLATE = Path(__file__).with_name("templates") / "stack.py.txt"
"""Simulator and controller as `avrare new scenario --python` writes them."""


class FileOptions(Options):
    """File whose code is run."""

    file: str = Field(min_length=1, description="Python file; it is run", json_schema_extra={"file": True})

    @field_validator("file")
    @classmethod
    def _check_trust(cls, file: str) -> str:
        if is_safe():
            raise ValueError(f"safe mode: a Python file is code of no installed plugin; {TRUST}")
        if not Path(file).is_file():
            raise ValueError(
                "should be an existing file, beside the scenario or by its path from the current folder"
            )
        return file


class PythonConfig(FileOptions):
    """Class of a file, and the arguments of its objects."""

    class_: str = Field(alias="class", pattern=r"[A-Za-z_]\w*", description="name of the class in the file")
    options: Mapping[str, JsonValue] = Field({}, description="arguments of the class, by name")


class SimulatorConfig(PythonConfig):
    """Class of a simulator."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"file": str(TEMPLATE), "class": "Simulator"}]})


class ControllerConfig(PythonConfig):
    """Class of a controller."""

    model_config = ConfigDict(
        json_schema_extra={"examples": [{"file": str(TEMPLATE), "class": "Controller"}]}
    )


def build_simulator(config: PythonConfig, scene: Scene | None = None) -> object:
    """Build the simulator of a scenario; a class whose ``signals`` takes no world holds one world itself."""
    make = _prepare(config, scene)
    read = inspect.getattr_static(make.func, "signals", None)
    simulator: Any = make()
    if not callable(read) or len(inspect.signature(read).parameters) != 1:
        return simulator
    if not hasattr(simulator, "dt"):
        raise UsageError(f"{config.file}: {config.class_} has no dt", "dt = 0.1  # time of a step [s]")
    return Worlds(make, dt=simulator.dt)


def build_controller(config: PythonConfig, scene: Scene | None) -> object:
    """Build the controller of a scenario; a class that takes a ``scene`` gets the road."""
    return _prepare(config, scene)()


def _prepare(config: PythonConfig, scene: Scene | None) -> partial[object]:
    cls = find_member(config.file, config.class_, "class {}: ...")
    arguments: dict[str, object] = dict(config.options)
    signature = inspect.signature(cls)
    names = [name for name in signature.parameters if name != "scene"]
    if "scene" in signature.parameters:
        arguments["scene"] = scene
    try:
        signature.bind(**arguments)
    except TypeError as error:
        hint = f"`options` of {config.class_}: {', '.join(names) or 'none'}"
        raise UsageError(f"{config.file}: {config.class_}: {error}", hint) from None
    return partial(cls, **arguments)


def find_member(file: str, name: str, pattern: str) -> Callable[..., object]:
    """Run a file and return its class or function of this name.

    Raises:
        UsageError: The file cannot be run, or lacks it; ``pattern`` shows how it is written.
    """
    members = vars(_run(Path(file)))
    if callable(member := members.get(name)):
        return cast("Callable[..., object]", member)
    names = [word for word, value in members.items() if callable(value) and word[:1] != "_"]
    raise UsageError(f"{file}: has no {name!r}", did_you_mean(name, names) or pattern.format(name))


def _run(path: Path) -> ModuleType:
    if not path.is_file():
        raise UsageError(f"{path}: no such file", "its path is relative to the current folder")
    code, place = path.read_bytes(), path.resolve()
    name = f"{path.stem}_{zlib.crc32(bytes(place)):08x}_{zlib.crc32(code):08x}"
    if name in sys.modules:  # parts of one file share its classes
        return sys.modules[name]
    module = ModuleType(name)
    module.__file__ = str(path)
    before = list(sys.path)
    sys.path.insert(0, str(place.parent))  # it may import files beside it
    sys.modules[name] = module  # dataclasses and pickle look there
    try:
        exec(compile(code, str(path), "exec"), vars(module))
    except (Exception, SystemExit) as error:
        del sys.modules[name]
        raise UsageError(f"{path}: cannot be run: {type(error).__name__}: {error}") from error
    finally:
        sys.path[:] = before
    return module
