"""``avrare new``: a complete plugin package, a scenario file, or a catalogue of a folder's scenes."""

from __future__ import annotations

import argparse
import re
import shlex
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from pkgutil import resolve_name

from avrare.analysis.check.validation import first_steps
from avrare.analysis.rates.new_catalogue import CatalogueWriter, write_catalogue
from avrare.base.errors import AvrareError, UsageError
from avrare.base.number_format import format_count
from avrare.cli.output import say
from avrare.plugin.new_package import check_name, write
from avrare.plugin.registry import Registry, default_registry
from avrare.rollout.loaded_scenario import load
from avrare.stack.new_scenario import write_python_scenario, write_scenario, write_stack
from avrare.stack.trial import try_stack


def execute(args: argparse.Namespace) -> None:
    """Write the package, the scenario or the catalogue and print the next commands."""
    if args.what == "catalogue":
        _write_catalogue(args)
        return
    if args.ego is not None or args.stack is not None:
        raise UsageError("--ego and --stack are for catalogues", "avrare new catalogue FOLDER")
    if args.what == "scenario":
        _write_scenario(args)
        return
    if args.act or args.python:
        option = "--act" if args.act else "--python"
        raise UsageError(f"{option} is for scenarios", f"avrare new scenario NAME {option}")
    kinds = list(dict.fromkeys(kind for text in args.kind for kind in text.split(",")))
    if not kinds:
        raise UsageError("--kind is required for a plugin", "for example --kind simulator,controller")
    name = check_name(args.name, kinds, default_registry())
    folder = write(name, kinds, Path(args.out), driving=not args.no_driving)
    say(f"{folder}: {' and '.join(kinds)} {name!r}")
    say(f"next: pip install -e '{folder}[test]' && avrare plugins --check {name} && pytest {folder}")


def _write_scenario(args: argparse.Namespace) -> None:
    if args.kind or args.no_driving:
        raise UsageError(
            "--kind and --no-driving are for plugins", "avrare new scenario NAME --simulator NAME"
        )
    name = args.name.removesuffix(".yaml")
    if not re.fullmatch(r"\w[\w.-]*", name):
        raise UsageError(
            f"{args.name!r} does not name a scenario: use letters, digits, -, _ and .", "for example cut_in"
        )
    path = Path(args.out) / f"{name}.yaml"
    if args.python:
        if args.simulator or args.set or args.act:
            raise UsageError(
                "--python writes a simulator of its own", "leave out --simulator, --set and --act"
            )
        simulator, controller = write_python_scenario(path)
        say(f"{path}: {simulator.name} has its Simulator, {controller.name} its Controller")
    else:
        signals = write_scenario(path, args.simulator, args.set, default_registry(), args.act)
        say(f"{path}: signals {', '.join(signals)}")
    if args.act:
        say(f"{path.with_suffix('.py')}: act(observation), the controller")
    file = shlex.quote(str(path))
    commands = f"avrare validate --build {file} && avrare run {file}"
    error = _find_obstacle(path)
    if error is None:
        say(f"next: {commands}")
        return
    if args.act:
        step = error.hint or "correct the controller"
    else:
        step = f"{error.hint or 'add a `controller:`'}; or repeat with --act, which writes a first controller"
    say(f"it does not run yet: {error.message}", f"next: {step}; then {commands}")


def _write_catalogue(args: argparse.Namespace) -> None:
    if args.kind or args.no_driving or args.act or args.python or args.set:
        raise UsageError(
            "a catalogue takes --simulator, --ego, --stack and --out", "avrare new catalogue FOLDER"
        )
    source = Path(args.name)
    for source_path in (args.name, args.stack):
        if source_path is not None and not Path(source_path).exists():
            raise UsageError(f"{source_path}: no such file or folder", "give a folder of scenes, or a file")
    registry = default_registry()
    component = registry.require("simulator", args.simulator or _choose_reader(registry))
    if not component.scenes:
        raise UsageError(
            f"simulator {args.simulator!r} reads no files of scenes",
            f"--simulator {_choose_reader(registry)}",
        )
    path = Path(args.out) / f"{source.resolve().stem}.yaml"
    stack = Path(args.stack or path.with_name(f"{path.stem}_stack.yaml"))
    with _take_back(() if args.stack else (stack, stack.with_suffix(".py"))):
        if args.stack is None:
            write_stack(stack)
        writer = CatalogueWriter(component, str(stack))
        scenes = writer.list_scenes(resolve_name(component.scenes)(str(source), args.ego))
        for (file, reason), cells in writer.reasons.items():
            say(f"left out: {file} ({format_count(cells, 'cell')}): {reason}", error=True)
        if not scenes:
            raise UsageError(
                f"{source}: has no scene that the stack can drive in",
                "`avrare scenes` lists the features of files that are read",
            )
        write_catalogue(path, scenes, str(stack))
    if args.stack is None:
        say(f"{stack}: the stack; {stack.with_suffix('.py')}: act(observation), its controller")
    total = format_count(sum(scene.cells for scene in scenes), "cell")
    say(
        f"{path}: {format_count(len(scenes), 'scene')} of {total}",
        f"next: avrare rate {shlex.quote(str(path))}",
    )


@contextmanager
def _take_back(files: Sequence[Path]) -> Iterator[None]:
    # Files that are new are removed where what is written beside them is refused.
    new_files = [file for file in files if not file.exists()]
    try:
        yield
    except BaseException:
        for file in new_files:
            file.unlink(missing_ok=True)
        raise


def _choose_reader(registry: Registry) -> str:
    names = [row.name for row in registry.rows() if row.component is not None and row.component.scenes]
    if len(names) != 1:
        hint = f"--simulator {' | '.join(names)}" if names else "pip install avrare-openscenario"
        raise UsageError("choose a simulator that reads files of scenes", hint)
    return names[0]


def _find_obstacle(path: Path) -> AvrareError | None:
    """Try the first step of a new scenario: only the simulator knows whether it needs a controller."""
    try:
        scenario = load(path)
        with first_steps(scenario.definition):
            try_stack(scenario.definition, scenario.stack, steps=1)
    except AvrareError as error:
        return error
    return None
