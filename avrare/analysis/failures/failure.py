"""Stored failure: noise tape, identity of the stack under test, and coarse signals.

The noise alone reproduces the rollout. The rest serves to name the difference if it does not: a fingerprint
of every part, the versions, a checksum of the signals of each step, and the signals rounded to a part in
8192.
"""

from __future__ import annotations

import hashlib
import json
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from avrare.base.errors import UsageError
from avrare.protocols import Floats
from avrare.rollout.loaded_scenario import LoadedScenario
from avrare.rollout.replay import ReplayedRollout, replay_tape, tabulate_signals
from avrare.scenario.fingerprint import comparable, digests
from avrare.scenario.schema import Scenario

_NO_CHECKSUMS = np.zeros(0, dtype=np.uint32)
_NO_VALUES = np.zeros((0, 0), dtype=np.float32)


@dataclass(frozen=True)
class Failure:
    """A failing rollout; a step has K signal values."""

    scenario: str
    specification: str
    # Fingerprints of the parts that the rollout depends on, by name; seed and estimator are not among them.
    parts: Mapping[str, str]
    versions: Mapping[str, str]  # of avrare and the plugins when it was recorded
    robustness: float
    noise: Floats  # (steps + 1, noise_size)
    checksums: NDArray[np.uint32]  # (steps + 1,) of all signals of a step, exact; (0,) if not stored
    columns: tuple[str, ...]  # (K,) names
    values: NDArray[np.float32]  # (steps + 1, K) rounded; (0, K) if there are too many

    @property
    def id(self) -> str:
        """8 hexadecimal digits of a hash of parts and noise: the same failure has the same id everywhere."""
        digest = hashlib.sha256(json.dumps(dict(self.parts), sort_keys=True).encode())
        digest.update(repr(self.noise.shape).encode())
        digest.update(np.ascontiguousarray(self.noise, dtype="<f8").tobytes())
        return digest.hexdigest()[:8]

    @property
    def norm(self) -> float:
        """Euclidean norm of the noise."""
        return float(np.linalg.norm(self.noise))

    def without_signals(self) -> Failure:
        """Return the failure without checksums and signals."""
        return replace(self, checksums=_NO_CHECKSUMS, columns=(), values=_NO_VALUES)


def compute_fingerprints(scenario: Scenario, specification: str) -> dict[str, str]:
    """Return 8 hexadecimal digits for each part that a rollout of one specification depends on."""
    resolved, files = comparable(scenario), digests(scenario)
    parts = ("simulator", "perception", "tracker", "controller")
    plain = {"steps": resolved["steps"], **{part: resolved.get(part) for part in parts}}
    plain |= {name: resolved[name] for name in ("timing", "actuators") if name in resolved}
    plain["specification"] = resolved["specifications"][specification]
    for name in (*parts, "specification"):
        path = f"specifications.{specification}" if name == "specification" else name
        contents = {key: content for key, content in files.items() if key.startswith(f"{path}.")}
        if contents:  # the content of files named by options counts too
            plain[name] = {"options": plain[name], "files": contents}
    texts = {name: json.dumps(part, sort_keys=True, separators=(",", ":")) for name, part in plain.items()}
    return {name: hashlib.sha256(text.encode()).hexdigest()[:8] for name, text in texts.items()}


def record_failure(scenario: LoadedScenario, specification: str, tape: Floats) -> Failure:
    """Run a noise tape (steps + 1, noise_size) and return its failure; UsageError if it does not fail."""
    rollout = replay_tape(scenario.problem(specification), tape)
    if rollout.error is not None:
        raise UsageError(f"{scenario.name}: the rollout ended with an error: {rollout.error}")
    if not rollout.violated:
        raise UsageError(f"{scenario.name}: the rollout does not violate {specification}")
    return make_failure(scenario, specification, tape, rollout)


def make_failure(
    scenario: LoadedScenario, specification: str, tape: Floats, rollout: ReplayedRollout
) -> Failure:
    """Return the failure of a complete rollout, with its signals."""
    columns, numbers = tabulate_signals(rollout.signals, scenario.scene)
    # of more, only the checksums are stored
    values = round_values(numbers if numbers.size <= 20_000 else numbers[:0])
    parts = compute_fingerprints(scenario.definition, specification)
    return Failure(
        scenario.name,
        specification,
        parts,
        scenario.definition.versions,
        rollout.robustness,
        np.array(tape, dtype=np.float64),
        compute_checksums(rollout.signals),
        columns,
        values,
    )


def make_failure_of_run(
    scenario: LoadedScenario, specification: str, tape: Floats, robustness: float, versions: Mapping[str, str]
) -> Failure:
    """Return a failure stored in a run folder, without signals, from its tape (steps + 1, noise_size)."""
    scenario.problem(specification)  # raises a UsageError if the scenario has none of that name
    parts = compute_fingerprints(scenario.definition, specification)
    return Failure(
        scenario.name, specification, parts, versions, robustness, tape, _NO_CHECKSUMS, (), _NO_VALUES
    )


def compute_checksums(signals: Mapping[str, NDArray[np.generic]]) -> NDArray[np.uint32]:
    """Return a checksum (T,) of all signals (T, ...) of each step, independent of their order."""
    arrays = [np.ascontiguousarray(signals[name]) for name in sorted(signals)]
    little = [array.astype(array.dtype.newbyteorder("<")) for array in arrays]
    steps = len(arrays[0]) if arrays else 0
    sums = [zlib.crc32(b"".join(array[t].tobytes() for array in little)) for t in range(steps)]
    return np.array(sums, dtype=np.uint32)


def round_values(values: Floats) -> NDArray[np.float32]:
    """Round to 13 binary digits: enough to see what has changed, and small when compressed."""
    with np.errstate(over="ignore"):
        bits = np.ascontiguousarray(values, dtype=np.float32).view(np.uint32)
    return ((bits + np.uint32(1 << 10)) & np.uint32(0xFFFFFFFF << 11 & 0xFFFFFFFF)).view(np.float32)
