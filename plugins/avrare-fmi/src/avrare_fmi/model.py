"""FMU, unpacked, and its instances."""

from __future__ import annotations

import copy
import hashlib
import os
import weakref
from collections.abc import Iterable, Sequence
from contextlib import suppress
from functools import cached_property
from pathlib import Path
from shutil import rmtree
from tempfile import mkdtemp
from typing import Any

import fmpy
from fmpy.fmi2 import FMU2Slave
from fmpy.fmi3 import FMU3Slave

from avrare.base.errors import UsageError, did_you_mean

_KINDS = {
    "Real": "Real",
    "Integer": "Integer",
    "Enumeration": "Integer",
    "Boolean": "Boolean",
    "String": "String",
    **{name: name for name in ("Float64", "Float32", "Int64", "Int32", "Int16", "Int8")},
    **{name: name for name in ("UInt64", "UInt32", "UInt16", "UInt8")},
}
"""Type of a variable, and the word for it in the functions that get and set it; FMI 2, then FMI 3."""


class Model:
    """FMU for co-simulation.

    Args:
        file: Path of the FMU.

    Raises:
        UsageError: It cannot be read, or is none for co-simulation.
    """

    def __init__(self, file: str) -> None:
        self.file, self.alive = file, weakref.WeakSet[Instance]()
        hint = "an FMU 2 or 3 for co-simulation, with code for this machine"
        if not Path(file).is_file():
            raise UsageError(f"{file}: no such file", "its path is relative to the current folder")
        try:
            self.description: Any = fmpy.read_model_description(file)
        except Exception as error:  # fmpy raises plain ones
            raise UsageError(f"{file}: no FMU that can be read: {error}", hint) from error
        self.version = int(self.description.fmiVersion[0])
        if self.version < 2 or self.description.coSimulation is None:
            raise UsageError(
                f"{file}: FMI {self.description.fmiVersion}"
                f"{'' if self.description.coSimulation else ' without co-simulation'}",
                hint,
            )
        self.variables = {variable.name: variable for variable in self.description.modelVariables}
        self.can_copy = bool(self.description.coSimulation.canGetAndSetFMUstate)
        self.can_serialise = bool(self.description.coSimulation.canSerializeFMUstate)

    @cached_property
    def _folder(self) -> Path:  # by content: all processes and runs unpack it once
        with open(self.file, "rb") as content:
            digest = hashlib.file_digest(content, "sha256").hexdigest()
        home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "avrare" / "fmu"
        folder = home / digest[:16]
        if not folder.exists():
            home.mkdir(parents=True, exist_ok=True)
            unpacked = mkdtemp(dir=home)
            fmpy.extract(self.file, unzipdir=unpacked)
            with suppress(OSError):  # another process was first
                os.rename(unpacked, folder)
            rmtree(unpacked, ignore_errors=True)
        return folder

    @cached_property
    def _functions(self) -> Any:  # of the library, which all instances share
        return (FMU2Slave if self.version == 2 else FMU3Slave)(
            guid=self.description.guid,
            modelIdentifier=self.description.coSimulation.modelIdentifier,
            unzipDirectory=str(self._folder),
        )

    def find(self, names: Iterable[str]) -> Variables:
        """Return variables by name.

        Raises:
            UsageError: The FMU lacks one, or it is an array.
        """
        variables = []
        for name in names:
            if name not in self.variables:
                raise UsageError(
                    f"{self.file}: has no variable {name!r}", did_you_mean(name, list(self.variables)) or None
                )
            variable = self.variables[name]
            if variable.type not in _KINDS or variable.dimensions:
                raise UsageError(f"{self.file}: {name} is an array or a {variable.type}", "take numbers")
            variables.append(variable)
        return Variables(variables)

    def instantiate(self) -> Instance:
        """Return a new instance.

        Raises:
            UsageError: The FMU has one already and allows no more, or it has no code for this machine.
        """
        if self.alive and self.description.coSimulation.canBeInstantiatedOnlyOncePerProcess:
            raise UsageError(
                f"{self.file}: can be instantiated only once per process",
                "chunk: 1, and estimator: mc",
            )
        try:
            fmu = copy.copy(self._functions)
            fmu.instantiate()
        except Exception as error:  # fmpy raises plain ones
            raise UsageError(f"{self.file}: cannot be instantiated: {error}") from error
        instance = Instance(fmu, self.version)
        self.alive.add(instance)
        return instance


class Instance:
    """Instance of an FMU, freed when this object is dropped.

    Attributes:
        fmu: The functions of FMI.
    """

    def __init__(self, fmu: Any, version: int) -> None:
        self.fmu, self._version = fmu, version
        free = fmu.fmi2FreeInstance if version == 2 else fmu.fmi3FreeInstance
        weakref.finalize(self, free, fmu.component)

    def enter_initialisation(self) -> None:
        """Enter initialisation at t = 0."""
        if self._version == 2:
            self.fmu.setupExperiment(startTime=0.0)
            self.fmu.enterInitializationMode()
        else:
            self.fmu.enterInitializationMode(startTime=0.0)


class State:
    """State of an instance: bytes where the FMU can serialise it, which any instance can take."""

    def __init__(self, instance: Instance, serialise: bool) -> None:
        fmu = instance.fmu
        self._bytes, self._state = b"", fmu.getFMUState()
        free = weakref.finalize(self, _free, instance, self._state)
        if serialise:
            self._bytes = fmu.serializeFMUState(self._state)
            free()

    def restore(self, instance: Instance) -> None:
        """Put an instance into this state."""
        if not self._bytes:
            instance.fmu.setFMUState(self._state)
            return
        state = instance.fmu.deserializeFMUState(self._bytes)
        instance.fmu.setFMUState(state)
        instance.fmu.freeFMUState(state)


def _free(instance: Instance, state: Any) -> None:  # the instance lives as long as its state
    instance.fmu.freeFMUState(state)


class Variables:
    """Variables in order, which are read and written by type."""

    def __init__(self, variables: Sequence[Any]) -> None:
        self._size = len(variables)
        kinds: dict[str, list[int]] = {}
        for i, variable in enumerate(variables):
            kinds.setdefault(_KINDS[variable.type], []).append(i)
        self._groups = [
            (kind, places, [variables[i].valueReference for i in places]) for kind, places in kinds.items()
        ]

    def get(self, instance: Instance) -> list[float]:
        """Return the values."""
        values = [0.0] * self._size
        for kind, places, references in self._groups:
            for place, value in zip(places, getattr(instance.fmu, f"get{kind}")(references), strict=True):
                values[place] = float(value)
        return values

    def set(self, instance: Instance, values: Sequence[float | bool | str]) -> None:
        """Set the values; integers are rounded to the nearest."""
        for kind, places, references in self._groups:
            group: list[Any] = [values[place] for place in places]
            if "Int" in kind or kind == "Boolean":
                group = [round(float(value)) for value in group]
            getattr(instance.fmu, f"set{kind}")(references, group)
