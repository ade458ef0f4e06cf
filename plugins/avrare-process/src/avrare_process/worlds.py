"""Worlds in a program: one for each rollout of a chunk, known to it by a number."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from pydantic import ValidationError

from avrare.base.errors import UsageError
from avrare.protocols import Floats
from avrare.worlds import World
from avrare_process.config import Hello, ProcessConfig
from avrare_process.process import Process, ProcessEnded

PROTOCOL = 1
"""Version of the messages."""


class Client:
    """Program of a scenario, started again after it has ended.

    Args:
        config: Options of a scenario.
        role: "simulator" or "controller".

    Attributes:
        hello: Answer to ``hello``.
        life: Number of times that it has ended; its worlds are lost then.
        free: Numbers of worlds that are not used.
        size: Number of worlds.

    Raises:
        UsageError: The program cannot be started, or its answer to ``hello`` is wrong.
    """

    def __init__(self, config: ProcessConfig, role: str) -> None:
        self._config, self._role = config, role
        self.life, self.size = 0, 0
        self.free: list[int] = []
        try:
            self._process, self.hello = self._start()
        except (ProcessEnded, TimeoutError, RuntimeError) as error:
            raise UsageError(str(error), "it answers `hello`: see docs/your-own-simulator.md") from error

    def _start(self) -> tuple[Process, Hello]:
        process = Process(self._config)
        message = {"do": "hello", "protocol": PROTOCOL, "role": self._role, "options": self._config.options}
        answer = process.ask(message)
        process.limit_answers(self._config.timeout)
        try:
            return process, Hello(**answer)
        except ValidationError as error:
            first = error.errors()[0]
            place = ".".join(map(str, first["loc"]))
            raise UsageError(
                f"{self._config.command[0]} answered wrongly to hello: {place}: {first['msg']}",
                '{"outputs": ["gap", "speed"], "noise": ["radar"], "dt": 0.1, "copy": true}',
            ) from None

    def ask(self, message: dict[str, object]) -> dict[str, Any]:
        """Return the answer to a message; a program that has ended is started first."""
        if not self._process.end.alive:
            self._process, _ = self._start()
        try:
            return self._process.ask(message)
        finally:
            self.life += not self._process.end.alive

    def move(self, do: str, numbers: list[int], **rows: object) -> list[list[float]]:
        """Return the outputs of worlds after ``reset`` or ``step``."""
        outputs: Any = self.ask({"do": do, "worlds": numbers, **rows}).get("outputs")
        width = len(self.hello.outputs) + len(self.hello.seen)
        if np.shape(outputs) != (len(numbers), width):
            raise UsageError(
                f"{self._config.command[0]} answered to {do} with outputs of shape {np.shape(outputs)}",
                f"a row of {width} numbers for each of the worlds, {len(numbers)} here",
            )
        return list(outputs)


class Place:
    """Number of a world in the program, free again when this object is dropped."""

    def __init__(self, client: Client) -> None:
        self._free = client.free
        if not self._free:
            self._free.append(client.size)
            client.size += 1
        self.number = self._free.pop()

    def __del__(self) -> None:
        self._free.append(self.number)


class RemoteWorld(World):
    """World in the program.

    Attributes:
        life: Life of the program in which its state is known; -1: in none.
        outputs: Its newest numbers.
    """

    has_table = True

    def __init__(self, client: Client) -> None:
        self.client, self.place = client, Place(client)
        self.noise_size, self.noise_names = len(client.hello.noise), client.hello.noise or None
        self.life, self.outputs = -1, [np.nan] * (len(client.hello.outputs) + len(client.hello.seen))

    def reset(self, noise: Floats) -> None:
        """Reset to t = 0."""
        move([self], "reset", noise=[noise.tolist()])

    def step(self, action: Floats | None, noise: Floats) -> None:
        """Advance by one step."""
        move([self], "step", inputs=None if action is None else [action.tolist()], noise=[noise.tolist()])

    def numbers(self) -> list[float]:
        """Return the newest outputs."""
        return self.outputs

    def split_table(self, table: Floats) -> tuple[dict[str, Floats], Floats]:
        """Split outputs (N, K) into signals and observations."""
        names = self.client.hello.outputs
        observed = table[:, len(names) :] if self.client.hello.seen else table
        return dict(zip(names, table.T.copy(), strict=False)), observed.copy()

    def signals(self) -> dict[str, float]:
        """Return the signals."""
        return dict(zip(self.client.hello.outputs, self.outputs, strict=False))

    def snapshot(self) -> RemoteWorld:
        """Return a copy in the same program."""
        copy = RemoteWorld(self.client)
        copy.restore(self)
        return copy

    def restore(self, snapshot: RemoteWorld) -> None:
        """Continue from a copy."""
        self.client.ask({"do": "copy", "from": [snapshot.place.number], "to": [self.place.number]})
        self.life, self.outputs = snapshot.life, snapshot.outputs

    @property
    def alive(self) -> bool:
        """True while the program has its state."""
        return self.life == self.client.life


def move(worlds: Sequence[RemoteWorld], do: str, **rows: object) -> None:
    """Move worlds of one program by one message; after an error their states are unknown."""
    client = worlds[0].client
    for world in worlds:
        world.life = -1
    outputs = client.move(do, [world.place.number for world in worlds], **rows)
    for world, row in zip(worlds, outputs, strict=True):
        world.life, world.outputs = client.life, row
