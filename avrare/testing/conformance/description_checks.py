"""Description checks: the declarations of a plugin about a component, before it is built."""

from __future__ import annotations

import json
import pickle
import subprocess
import sys
from importlib.metadata import entry_points
from typing import Literal, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo

from avrare.plugin.component import GROUP
from avrare.plugin.options import Options
from avrare.stack.part_checks import check_declarations, check_dynamics
from avrare.testing.conformance.suite import Subject

HEAVY = (
    "torch", "pyro", "casadi", "matplotlib", "plotly", "ray", "pandas", "numba", "gymnasium", "scipy.stats",
    "tensorflow", "jax",
)  # fmt: skip
"""Modules that listing and validating must not import."""

_PROBE = """
import importlib, json, sys
sys.path[:] = {path!r}
before = set(sys.modules)
for module in {modules!r}:
    importlib.import_module(module)
print(json.dumps([name for name in {heavy!r} if name in sys.modules and name not in before]))
"""


def description_is_light(subject: Subject) -> None:
    """Listing the component and checking its options imports nothing heavy."""
    part = subject.component
    points = [
        point.value
        for point in entry_points(group=GROUP)
        if point.dist is not None and point.dist.name == subject.row.distribution
    ]
    options = part.auto.options if part.auto is not None else ""
    references = [*points, part.config, part.rules, part.check, options]
    modules = [reference.partition(":")[0] for reference in references if reference]
    program = _PROBE.format(path=sys.path, modules=modules, heavy=HEAVY)
    process = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert process.returncode == 0, process.stderr.strip().splitlines()[-1:] or "it cannot be imported"
    heavy_modules = json.loads(process.stdout.splitlines()[-1])
    assert not heavy_modules, f"imports {', '.join(heavy_modules)}: import it inside the factory"


def summary_is_one_line(subject: Subject) -> None:
    """The summary is one line of at most 120 characters."""
    words = subject.component.summary
    assert words.strip(), "it is empty"
    assert "\n" not in words, "it has several lines"
    assert len(words) <= 120, f"{len(words)} characters; 120 fit a table"


def config_is_strict(subject: Subject) -> None:
    """The options are frozen and refuse unknown keys."""
    model = subject.model
    assert isinstance(model, type), f"{model!r} is not a class"
    assert issubclass(model, Options), f"derive {model.__name__} from avrare.plugin.Options"
    for config in _list_models(model):
        settings = (config.model_config.get("extra"), config.model_config.get("frozen"))
        expected = 'ConfigDict(extra="forbid", frozen=True)'
        assert settings == ("forbid", True), f"{config.__name__}: set model_config = {expected}"
    try:
        model.model_validate({"no_such_option_": 1})
    except ValidationError as error:
        kinds = {entry["type"] for entry in error.errors()}
        assert kinds - {"missing"}, "an unknown key raises no error about it"
    else:
        raise AssertionError("an unknown key is accepted")


def options_are_described(subject: Subject) -> None:
    """Every option has a description, and a length, time or speed its unit in brackets."""
    options = [
        (f"{option.__name__}.{name}", name, field)
        for option in _list_models(subject.model)
        for name, field in option.model_fields.items()
    ]
    bare = [place for place, _, field in options if not (field.description or _is_tag(field))]
    assert not bare, f"no description: {', '.join(bare)}"
    # only by the name: a dimensionless number cannot be told from others in general
    numbers = [
        option
        for option in options
        if option[2].annotation is float and option[1].rpartition("_")[2] in DIMENSIONS
    ]
    unitless = [place for place, _, field in numbers if "[" not in (field.description or "")]
    assert not unitless, f"no unit in brackets: {', '.join(unitless)}"


def _is_tag(field: FieldInfo) -> bool:
    # one value only: it tells the members of a union apart
    return get_origin(field.annotation) is Literal and len(get_args(field.annotation)) == 1


def options_pickle(subject: Subject) -> None:
    """The options survive pickling, which is how a scenario travels to a worker."""
    copy = pickle.loads(pickle.dumps(subject.config))
    assert copy == subject.config, "they come back changed"


def factory_builds(subject: Subject) -> None:
    """The factory builds the part from its defaults, the options given, or its model's example."""
    part = subject.build()
    if subject.kind in ("simulator", "perception"):
        assert isinstance(part.noise_size, int), f"noise_size is {part.noise_size!r}, not an integer"
        assert part.noise_size >= 0, f"noise_size is {part.noise_size}"
        check_declarations(part)
    if subject.kind == "simulator":
        check_dynamics(part)
        assert part.dt > 0.0, f"dt is {part.dt!r}; it must be more than 0 s"


DIMENSIONS = frozenset(
    {"dt", "speed", "acceleration", "distance", "length", "width", "height", "radius", "duration", "mass"}
)
"""Last words of option names that need a unit."""


def _list_models(model: type[BaseModel]) -> list[type[BaseModel]]:
    models = [model]
    for current in models:
        for field in current.model_fields.values():
            models += [inner for inner in _inside(field.annotation) if inner not in models]
    return models


def _inside(annotation: object) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for part in get_args(annotation) for model in _inside(part)]


CHECKS = (
    description_is_light,
    summary_is_one_line,
    config_is_strict,
    options_are_described,
    options_pickle,
    factory_builds,
)
