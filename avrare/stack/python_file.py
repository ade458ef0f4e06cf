"""Parts from a Python file, without a package: a class as simulator or controller, or a function."""

from __future__ import annotations

import inspect
import sys
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple, cast

import numpy as np
from pydantic import ConfigDict, Field, JsonValue, field_validator

from avrare.base import batch
from avrare.base.errors import UsageError, did_you_mean
from avrare.driving import Action, ObservingEgo, Prediction, Scene, Vehicles
from avrare.plugin import Options
from avrare.protocols import Controller
from avrare.scenario.safe_mode import TRUST, is_safe
from avrare.worlds import Worlds

TEMPLATES = Path(__file__).with_name("templates")
"""Folder of the simulator and the controller as `avrare new scenario --python` writes them."""


class FileOptions(Options):
    """File whose code is run."""

    file: str = Field(min_length=1, description="Python file; it is run", json_schema_extra={"file": True})

    @field_validator("file")
    @classmethod
    def _check_trust(cls, file: str) -> str:
        if is_safe():
            raise ValueError(f"safe mode runs installed plugins only, and no Python files; {TRUST}")
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

    model_config = ConfigDict(
        json_schema_extra={"examples": [{"file": str(TEMPLATES / "stack.py.txt"), "class": "Simulator"}]}
    )


class ControllerConfig(PythonConfig):
    """Class of a controller."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [{"file": str(TEMPLATES / "stack_controller.py.txt"), "class": "Controller"}]
        }
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


EXAMPLE = Path(__file__).with_name("templates") / "act.py.txt"
"""Function for simulators without vehicles, as `avrare new scenario --act` writes it."""


class FunctionConfig(FileOptions):
    """File and name of the function, and the form of its call."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"file": str(EXAMPLE)}]})

    function: str = Field("act", pattern=r"[A-Za-z_]\w*", description="name of the function in the file")
    batched: bool = Field(
        False, description="call it once for all rollouts, with arrays (N, ...), instead of once for each"
    )


class Neighbour(NamedTuple):
    """Other vehicle as the tracker knows it: floats, or arrays (N,) with x and y infinite where unknown.

    Attributes:
        x: Position along the road [m].
        y: Position across the road, left is positive [m].
        speed_x: Predicted speed along it [m/s].
        speed_y: Predicted speed across it [m/s].
    """

    x: Any
    y: Any
    speed_x: Any
    speed_y: Any


@dataclass(frozen=True)
class DrivingObservation:
    """Knowledge of a driving controller.

    Attributes:
        ego: x, y, heading, speed and acceleration of the ego: floats, or arrays (N,).
        others: Vehicles that the tracker knows of, by name; empty without a tracker. In a batch all of them.
        scene: Road, sizes and the step ``dt`` [s].
    """

    ego: Vehicles
    others: dict[str, Neighbour]
    scene: Scene


class FunctionController(Controller):
    """Controller that calls a function of its own file, without memory.

    Attributes:
        horizon: 1: the speeds of the others are those of the tracker's next prediction.
    """

    horizon = 1

    def __init__(self, function: Callable[..., object], batched: bool, scene: Scene | None) -> None:
        self.function, self.batched, self.scene = function, batched, scene

    def start(self, n: int) -> None:
        """Return None: it has no memory."""

    def act(self, memory: None, ego: Any, prediction: Prediction | None) -> tuple[Any, None]:
        """Return the actions of N rollouts.

        Raises:
            UsageError: The function returns a value of another shape.
        """
        if isinstance(ego, np.ndarray) or self.scene is None:
            view = ego.observation if isinstance(ego, ObservingEgo) else ego
            return (self._answer(view) if self.batched else self._rows(view, len(view))), None
        observation = DrivingObservation(ego, _neighbours(prediction, self.scene), self.scene)
        n = len(ego.x)
        answer = self._answer(observation) if self.batched else self._rows(observation, n)
        return _action(answer, n, self.batched), None

    def _rows(self, observation: object, n: int) -> Any:
        answers = [self._answer(_select_row(observation, row)) for row in range(n)]
        try:
            return np.array([np.atleast_1d(answer) for answer in answers], dtype=np.float64)
        except (TypeError, ValueError, OverflowError) as error:
            raise UsageError(f"{self.function.__name__} must return numbers: {error}") from None

    def _answer(self, observation: object) -> Any:
        answer = self.function(observation)
        if answer is None:
            raise UsageError(f"{self.function.__name__} returned None", "return the action")
        if isinstance(answer, Action):
            return answer.acceleration, answer.yaw_rate
        return answer


def _neighbours(prediction: Prediction | None, scene: Scene) -> dict[str, Neighbour]:
    if prediction is None:
        return {}
    x, y = prediction.x, prediction.y
    tracked = np.isfinite(x[..., 0]) & np.isfinite(y[..., 0])
    with np.errstate(invalid="ignore"):  # of vehicles that are infinitely far away
        speed_x, speed_y = (np.where(tracked, p[..., 1] - p[..., 0], 0.0) / scene.dt for p in (x, y))
    return {
        name: Neighbour(x[:, v, 0], y[:, v, 0], speed_x[:, v], speed_y[:, v])
        for v, name in enumerate(scene.names)
    }


def _select_row(observation: Any, row: int) -> Any:
    if not isinstance(observation, DrivingObservation):
        return observation[row]
    ego = batch.map_leaves(lambda leaf: float(leaf[row]) if leaf.ndim == 1 else leaf[row], observation.ego)
    others = {
        name: Neighbour(*(float(values[row]) for values in other))
        for name, other in observation.others.items()
        if np.isfinite(other.x[row]) and np.isfinite(other.y[row])
    }
    return DrivingObservation(ego, others, observation.scene)


def _action(answer: Any, n: int, batched: bool) -> Action:
    try:
        pair = answer if batched else np.reshape(answer, (n, 2)).T
        acceleration, yaw_rate = (
            np.broadcast_to(np.asarray(values, dtype=np.float64), (n,)) for values in pair
        )
    except (TypeError, ValueError, OverflowError) as error:
        expectation = "a pair (acceleration [m/s^2], yaw rate [rad/s])"
        raise UsageError(f"a driving controller's act must return {expectation}: {error}") from None
    return Action(acceleration.copy(), yaw_rate.copy())


def build_function(config: FunctionConfig, scene: Scene | None) -> FunctionController:
    """Run the file and build the controller of a scenario.

    Raises:
        UsageError: The file cannot be run, or has no such function.
    """
    function = find_member(config.file, config.function, "def {}(observation): ...")
    return FunctionController(function, config.batched, scene)
