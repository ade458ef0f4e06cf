"""A failure as a value: its noise, what it belongs to, and what was seen when it was driven.

The noise alone makes the drive again. The rest is there to say what has changed where it does not: a
fingerprint of every part, the versions, a checksum of the signals of each step, and the signals themselves,
to a part in 8192.
"""

from __future__ import annotations

import hashlib
import json
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrare.build.scenario import BuildableScenario
from avrare.errors import UsageError
from avrare.failures.driving import Drive, drive
from avrare.protocols import Floats
from avrare.scenario.files import digests
from avrare.scenario.schema import Scenario

PARTS = ("simulator", "perception", "tracker", "controller")
MOST_VALUES = 20_000
"""Signals of a failure are kept up to this many numbers; beyond, their checksums are."""


@dataclass(frozen=True)
class Failure:
    """A failing rollout.

    Attributes:
        scenario: Name of the scenario.
        specification: Name of the specification that is violated.
        parts: Part of the scenario that the rollout depends on -> its fingerprint; no seed, no estimator.
        versions: Of avrare and the plugins, when it was recorded.
        robustness: Of the rollout.
        noise: (steps + 1, noise_size).
        checksums: (steps + 1,) of all signals of a step, to the last bit; (0,) where they were not kept.
        columns: Names of the K numbers that the signals of a step are.
        values: (steps + 1, K) these numbers, coarsely; (0, K) where there are too many.
    """

    scenario: str
    specification: str
    parts: Mapping[str, str]
    versions: Mapping[str, str]
    robustness: float
    noise: Floats
    checksums: NDArray[np.uint32]
    columns: tuple[str, ...]
    values: NDArray[np.float32]

    @property
    def id(self) -> str:
        """8 hexadecimal digits of the parts and the noise: the same failure has the same name everywhere."""
        digest = hashlib.sha256(json.dumps(dict(self.parts), sort_keys=True).encode())
        digest.update(repr(self.noise.shape).encode())
        digest.update(np.ascontiguousarray(self.noise, dtype="<f8").tobytes())
        return digest.hexdigest()[:8]

    @property
    def bare(self) -> Failure:
        """The same failure without its signals."""
        checksums, values = np.zeros(0, dtype=np.uint32), np.zeros((0, 0), dtype=np.float32)
        return replace(self, checksums=checksums, columns=(), values=values)

    @property
    def norm(self) -> float:
        """Euclidean length of the noise."""
        return float(np.linalg.norm(self.noise))


def fingerprints(scenario: Scenario, specification: str) -> dict[str, str]:
    """8 hexadecimal digits of each part that a rollout of one specification depends on."""
    resolved, files = scenario.resolved, digests(scenario)
    plain = {"steps": resolved["steps"], **{part: resolved.get(part) for part in PARTS}}
    plain["specification"] = resolved["specifications"][specification]
    paths = {**{part: part for part in PARTS}, "specification": f"specifications.{specification}"}
    for name, path in paths.items():
        contents = {key: content for key, content in files.items() if key.startswith(f"{path}.")}
        if contents:  # what is in a file that an option names counts, too
            plain[name] = {"options": plain[name], "files": contents}
    return {name: _digest(part) for name, part in plain.items()}


def _digest(plain: Any) -> str:
    canonical = json.dumps(plain, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(canonical.encode()).hexdigest()[:8]


def record(scenario: BuildableScenario, specification: str, tape: Floats) -> Failure:
    """Drive a noise tape (steps + 1, noise_size) and keep it as a failure.

    Raises:
        UsageError: The rollout does not fail, or breaks down.
    """
    found = drive(scenario.problem(specification), tape)
    if found.error is not None:
        raise UsageError(f"{scenario.name}: the rollout breaks down: {found.error}")
    if not found.violated:
        raise UsageError(f"{scenario.name}: the rollout does not violate {specification}")
    return kept(scenario, specification, tape, found)


def kept(scenario: BuildableScenario, specification: str, tape: Floats, found: Drive) -> Failure:
    """The failure that a complete drive shows."""
    columns, numbers = table(found.signals, scenario)
    values = coarse(numbers if numbers.size <= MOST_VALUES else numbers[:0])
    definition = scenario.definition
    parts = fingerprints(definition, specification)
    return Failure(
        scenario.name, specification, parts, definition.versions, found.robustness,
        np.array(tape, dtype=np.float64), checksums(found.signals), columns, values,
    )  # fmt: skip


def of_run(
    scenario: BuildableScenario,
    specification: str,
    tape: Floats,
    robustness: float,
    versions: Mapping[str, str],
) -> Failure:
    """A failure from the folder of a run, of whose signals nothing is known.

    Args:
        scenario: That was run.
        specification: Whose failure.
        tape: (steps + 1, noise_size).
        robustness: As it was stored.
        versions: As they were then.

    Raises:
        UsageError: The scenario has no such specification.
    """
    scenario.problem(specification)
    parts = fingerprints(scenario.definition, specification)
    nothing = np.zeros(0, dtype=np.uint32), (), np.zeros((0, 0), dtype=np.float32)
    return Failure(scenario.name, specification, parts, versions, robustness, tape, *nothing)


def checksums(signals: Mapping[str, NDArray[Any]]) -> NDArray[np.uint32]:
    """(T,) of all signals (T, ...) of each step, whatever the order of their names."""
    arrays = [np.ascontiguousarray(signals[name]) for name in sorted(signals)]
    little = [array.astype(array.dtype.newbyteorder("<")) for array in arrays]
    steps = len(arrays[0]) if arrays else 0
    sums = [zlib.crc32(b"".join(array[t].tobytes() for array in little)) for t in range(steps)]
    return np.array(sums, dtype=np.uint32)


def coarse(values: Floats) -> NDArray[np.float32]:
    """The values to 13 binary digits: enough to see what has changed, and little to store."""
    with np.errstate(over="ignore"):
        bits = np.ascontiguousarray(values, dtype=np.float32).view(np.uint32)
    return ((bits + np.uint32(1 << 10)) & np.uint32(0xFFFFFFFF << 11 & 0xFFFFFFFF)).view(np.float32)


def table(
    signals: Mapping[str, NDArray[Any]], scenario: BuildableScenario | None = None
) -> tuple[tuple[str, ...], Floats]:
    """Names (K,) and values (T, K) of all numbers of the signals (T, ...), by name.

    An entry for each other vehicle is named by the vehicle: ``others_x[van]``.
    """
    scene = scenario.scene if scenario is not None else None
    columns: list[str] = []
    blocks: list[Floats] = []
    for name in sorted(signals):
        values = np.asarray(signals[name], dtype=np.float64)
        entries = [",".join(map(str, index)) for index in np.ndindex(values.shape[1:])]
        if scene is not None and values.shape[1:] == (len(scene.names),):
            entries = list(scene.names)
        columns += [f"{name}[{entry}]" if values.ndim > 1 else name for entry in entries]
        blocks.append(values.reshape(len(values), len(entries)))
    return tuple(columns), np.concatenate(blocks, axis=1) if blocks else np.zeros((0, 0))
