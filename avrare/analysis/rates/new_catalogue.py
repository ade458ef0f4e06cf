"""New catalogues: the scenes of a folder's files under one stack, as cells of a grid."""

from __future__ import annotations

import json
import math
import os
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import TypeAlias

import numpy as np

from avrare.base.atomic_files import explain_file_errors, write_text
from avrare.base.errors import AvrareError, UsageError
from avrare.plugin.component import Component, FoundScene
from avrare.protocols import Simulator
from avrare.scenario.load import load
from avrare.stack.builder import build_block

_PILOT, _ROLLOUTS = 10, 100
"""Rollouts of each scene, of the pilot and altogether."""
_NUMBER = re.compile(r"[-+]?\d+(\.\d*)?")

Choice: TypeAlias = Mapping[str, str]
Axis: TypeAlias = tuple[Choice, ...]


@dataclass(frozen=True)
class NewScene:
    """Scene of a new catalogue.

    Attributes:
        path: File of the scene.
        settings: ``KEY=VALUE`` overrides of the stack's scenario.
        cells: Cells that it represents.
    """

    path: str
    settings: tuple[str, ...]
    cells: int


@dataclass
class CatalogueWriter:
    """Lists the scenes of files that a stack can drive in.

    Attributes:
        component: Simulator of the files.
        stack: Scenario file whose simulator the scenes replace.
        reasons: Cells that are left out, by file and reason.
    """

    component: Component
    stack: str
    reasons: Counter[tuple[str, str]] = field(default_factory=Counter)

    def list_scenes(self, files: Iterable[FoundScene]) -> list[NewScene]:
        """Return the scenes of files, equal ones once."""
        scenes = (scene for file in files for scene in self._divide(file))
        return list({scene.settings: scene for scene in scenes}.values())

    def _divide(self, file: FoundScene) -> Iterator[NewScene]:
        drawn: list[Axis] = []
        # numbers of a larger file are drawn; its cells do not become scenes
        if math.prod(map(len, file.axes)) > 100:
            drawn = [axis for axis in file.axes if self._may_be_drawn(file, axis)]
        for choices in product(*(axis for axis in file.axes if axis not in drawn)):
            settings = self._write(file, {key: text for choice in choices for key, text in choice.items()})
            laws = tuple(_write_law(axis) for axis in drawn)
            try:
                cells = self._count_possible(self._build(settings), drawn)
                self._build(settings + laws)
            except AvrareError as error:
                self.reasons[file.path, error.lines()[0]] += math.prod(map(len, drawn))
                continue
            if cells:
                yield NewScene(file.path, settings + laws, cells)

    def _write(self, file: FoundScene, options: Choice) -> tuple[str, ...]:
        folder = os.path.dirname(self.stack) or "."
        shared = {"plugin": self.component.name, **file.options}
        shared["file"] = os.path.relpath(str(shared["file"]), folder)
        values = (f"simulator.{key}={_quote(text)}" for key, text in options.items())
        return f"simulator={json.dumps(shared)}", *values

    def _build(self, settings: Sequence[str]) -> Simulator:
        return build_block(load(self.stack, settings, "mc").simulator, None, Simulator)

    def _may_be_drawn(self, file: FoundScene, axis: Axis) -> bool:
        names = {name for choice in axis for name in choice}
        texts = [text for choice in axis for text in choice.values()]
        if len(axis) < 2 or len(names) > 1 or not all(map(_NUMBER.fullmatch, texts)):
            return False
        try:
            self._build(self._write(file, {})).drawing(dict.fromkeys(names))
        except AvrareError:
            return False  # it decides what the file means, or the reason is given with the scenes
        return True

    @staticmethod
    def _count_possible(simulator: Simulator, drawn: Sequence[Axis]) -> int:
        if not drawn:
            return 1
        names, values = zip(*map(_list_values, drawn), strict=True)
        rows = np.array(list(product(*values)))
        noise = np.zeros((len(rows), simulator.noise_size))
        world = simulator.reset_drawn(noise, dict(zip(names, rows.T, strict=True)))
        impossible = simulator.impossible(world)
        return len(rows) - (0 if impossible is None else int(impossible.sum()))


def write_catalogue(path: Path, scenes: Sequence[NewScene], stack: str) -> None:
    """Write a catalogue of scenes under a stack.

    Raises:
        UsageError: There are too many scenes, or the file exists or cannot be written.
    """
    most_scenes = 1000
    if len(scenes) > most_scenes:
        text = f"{len(scenes)} scenes are more than the {most_scenes} of a catalogue"
        raise UsageError(text, "give fewer files, or a folder of them at a time")
    if path.exists():
        raise UsageError(f"{path}: already exists", "choose another --out")
    lines = [
        f"name: {_name(path)}",
        "description: share of the cells of a grid; for rates, give scenes an `exposure` in place of `cells`",
        f"budget: {{rollouts: {_ROLLOUTS * len(scenes)}}}   # of all scenes together",
        f"pilot: {_PILOT}",
        "scenes:",
    ]
    numbers: Counter[str] = Counter()
    quote = "'"
    for scene in scenes:
        name = _name(scene.path)
        numbers[name] += 1
        lines += [
            f"  - name: {name}_{numbers[name]}",
            f"    scenario: {json.dumps(os.path.relpath(stack, path.parent))}",
            f"    cells: {scene.cells}",
            "    set:",
            *(f"      - '{setting.replace(quote, 2 * quote)}'" for setting in scene.settings),
        ]
    with explain_file_errors(f"{path}: cannot write", "choose another --out"):
        path.parent.mkdir(parents=True, exist_ok=True)
        write_text(path, "\n".join(lines) + "\n")


def _list_values(axis: Axis) -> tuple[str, list[float]]:
    # Option of an axis of numbers, and the numbers.
    name = next(iter(axis[0]))
    return name, sorted({float(choice[name]) for choice in axis})


def _write_law(axis: Axis) -> str:
    name, values = _list_values(axis)
    law = {"law": "discrete", "values": values, "weights": [1.0] * len(values)}
    return f"simulator.{name}={json.dumps(law)}"


def _quote(text: str) -> str:
    return text if _NUMBER.fullmatch(text) else json.dumps(text)


def _name(path: str | Path) -> str:
    return re.sub(r"\W+", "_", Path(path).stem, flags=re.ASCII).strip("_").lower()[:80] or "scene"
