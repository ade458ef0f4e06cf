"""New scenario files: a simulator with its options, and a formula over one of its signals."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pydantic.fields import FieldInfo

from avrare.base.atomic_files import explain_file_errors, write_text
from avrare.base.errors import UsageError
from avrare.plugin.registry import Registry
from avrare.protocols import Signals
from avrare.scenario.overrides import override
from avrare.scenario.validation import check_options
from avrare.scenario.value_positions import Mark, Node

_TEMPLATES = Path(__file__).with_name("templates")


def write_scenario(
    path: Path, simulator: str | None, settings: Sequence[str], registry: Registry, act: bool = False
) -> tuple[str, ...]:
    """Write a scenario for an installed simulator, which runs as written or once it has a controller.

    Args:
        path: File to write; its stem is the scenario's name.
        simulator: Name of the simulator; None: the only one that is installed.
        settings: ``KEY=VALUE`` for options of the simulator.
        registry: Installed components.
        act: Also write a controller, a function in a Python file beside it; a scenario that was written
            without one, and not touched since, is replaced.

    Returns:
        Names of the simulator's signals.

    Raises:
        UsageError: The simulator is not installed, an option is missing, or the file exists.
        PluginError: The simulator's plugin is missing.
    """
    name = simulator or _choose_simulator(registry)
    component = registry.require("simulator", name)
    mark = Mark("--set")
    options: dict[str, Any] = override(Node({}, mark, mark), settings).plain()
    config = check_options(component.load_config(), name, options, kind="simulator")
    built = component.build(config)
    world = built.reset(np.zeros((1, built.noise_size)))
    signals = built.signals(world)
    if act and not hasattr(world, "ego"):
        raise UsageError(f"simulator {name!r} takes no actions: it needs no controller", "leave out --act")
    head = [
        f"name: {path.stem}",
        "description: the traffic and the danger in one sentence",
        f"steps: 100   # of {built.dt:g} s",
        "simulator:",
        f"  plugin: {name}",
        *_list_options(type(config).model_fields, options),
    ]
    tail = _list_requirements(signals)
    texts = {}
    if act:
        template = "act.py.txt" if built.scene is None else "act_driving.py.txt"
        texts[path.with_suffix(".py")] = (_TEMPLATES / template).read_text(encoding="utf-8")
    no_controller = (
        "# controller: {plugin: NAME}   # the stack under test, where the simulator does not drive it"
    )
    plain = "\n".join([*head, no_controller, *tail]) + "\n"
    texts[path] = "\n".join([*head, *_list_controller(path), *tail]) + "\n" if act else plain
    _write_files(texts, plain)
    return tuple(signals)


def _list_requirements(signals: Signals) -> list[str]:
    return [
        "specifications:",
        f"  # signals: {', '.join(signals)}",
        f'  first: {{stl: "{_formula(signals)}"}}   # replace it by a requirement of your own',
        "estimator: {plugin: mc, rollouts: 1000}   # a first look; auto finds rare failures",
        "# thresholds:",
        '#   - {specification: first, probability: "< 0.01"}   # decided by `avrare check`',
    ]


def write_python_scenario(path: Path) -> tuple[Path, Path]:
    """Write Python files of a simulator and of a controller, and a scenario of them that runs as it is.

    The controller has a file of its own, as a change of the simulator's makes baselines incomparable.

    Returns:
        File of the simulator, and of the controller.

    Raises:
        UsageError: One of the files exists.
    """
    simulator, controller = path.with_suffix(".py"), path.with_name(f"{path.stem}_controller.py")
    parts = (simulator, "stack.py.txt"), (controller, "stack_controller.py.txt"), (path, "stack.yaml.txt")
    texts = {file: (_TEMPLATES / template).read_text(encoding="utf-8") for file, template in parts}
    for key, value in (
        ("$name", path.stem),
        ("$file", json.dumps(simulator.name)),
        ("$controller", json.dumps(controller.name)),
    ):
        texts[path] = texts[path].replace(key, value)
    _write_files(texts)
    return simulator, controller


def write_stack(path: Path) -> None:
    """Write a scenario without a simulator: a controller in Python, for road vehicles, and a requirement.

    Raises:
        UsageError: The file exists.
    """
    lines = [
        f"name: {path.stem}",
        "steps: 200",
        *_list_controller(path),
        "specifications:",
        '  no_contact: {stl: "forall o in others: always (distance > 0)"}   # add requirements of your own',
    ]
    controller = (_TEMPLATES / "act_driving.py.txt").read_text(encoding="utf-8")
    _write_files({path.with_suffix(".py"): controller, path: "\n".join(lines) + "\n"})


def _write_files(texts: Mapping[Path, str], plain: str = "") -> None:
    # What this command itself has left, killed or without --act (``plain``), is no work of the user's.
    for file, text in texts.items():
        if file.exists() and file.read_bytes() not in (text.encode(), plain.encode()):
            raise UsageError(f"{file}: already exists", "choose another name or --out")
    for file, text in texts.items():
        with explain_file_errors(f"{file}: cannot write", "choose another --out"):
            file.parent.mkdir(parents=True, exist_ok=True)
            write_text(file, text)


def _list_controller(path: Path) -> list[str]:
    return [
        "controller:",
        "  plugin: function   # for a first try; `avrare new plugin --kind controller` is the lasting form",
        f"  file: {json.dumps(path.with_suffix('.py').as_posix())}   # relative to the current folder",
    ]


def _choose_simulator(registry: Registry) -> str:
    names = [row.name for row in registry.rows() if row.kind == "simulator" and row.status == "ok"]
    if len(names) == 1:
        return names[0]
    if not names:
        hint = "pip install 'avrare[driving]', or write your own: avrare new plugin NAME --kind simulator"
        raise UsageError("no simulator is installed", hint)
    hint = f"--simulator {' | '.join(names)}; --python writes a simulator and a controller of your own"
    raise UsageError("choose a simulator", hint)


def _list_options(fields: Mapping[str, FieldInfo], options: Mapping[str, object]) -> list[str]:
    """Return the options that are set, and the others as comments with their defaults."""
    lines = [f"  {name}: {json.dumps(value)}" for name, value in options.items()]
    for name, field in fields.items():
        default = field.get_default(call_default_factory=True)
        if name not in options and isinstance(default, (str, int, float, bool, type(None))):
            lines.append(f"  # {name}: {json.dumps(default)}   # {field.description or ''}".rstrip(" #"))
    return lines


def _formula(signals: Signals) -> str:
    # a bound that the start keeps by a distance of its own size, at least 1
    for name, values in signals.items():
        start = np.asarray(values)
        if start.shape == (1,) and start.dtype.kind == "f" and np.isfinite(start[0]):
            return f"always ({name} < {start[0] + max(abs(start[0]), 1.0):.3g})"
    raise UsageError("the simulator has no scalar signal to write a formula about")
