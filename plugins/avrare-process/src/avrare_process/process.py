"""Program that answers messages, each a line of JSON."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import socket
import subprocess
import tempfile
import time
import weakref
from typing import Any

from avrare.base.errors import UsageError
from avrare_process.config import ProcessConfig


class ProcessEnded(Exception):
    """Program that ended before it answered."""


class Process:
    """Running program, which is ended when this object is dropped.

    Args:
        config: Options of a scenario.

    Raises:
        UsageError: The program cannot be started.
    """

    def __init__(self, config: ProcessConfig) -> None:
        self._name = config.command[0]
        self._log = tempfile.TemporaryFile()  # noqa: SIM115 (it lives as long as the program)
        try:
            self._socket, child = (_start if config.connect == "stdio" else _listen)(config, self._log)
        except OSError as error:
            hint = "`command` is a list: the program, then its arguments"
            raise UsageError(f"{self._name} cannot be started: {error}", hint) from None
        self.end = weakref.finalize(self, _end, self._socket, child)
        self._socket.settimeout(config.start_timeout)
        self._lines = self._socket.makefile("rb")

    def limit_answers(self, seconds: float) -> None:
        """Give the program at most so long for each answer from now on."""
        self._socket.settimeout(seconds)

    def ask(self, message: dict[str, object]) -> dict[str, Any]:
        """Return the answer to a message.

        Raises:
            ProcessEnded: The program has ended.
            TimeoutError: It did not answer in time, and was ended.
            RuntimeError: It answered with an error.
        """
        try:
            self._socket.sendall(json.dumps(message).encode() + b"\n")
            line = self._lines.readline()
        except TimeoutError:
            text = f"{self._name} did not answer to {message['do']} within {self._socket.gettimeout():g} s"
            self.end()
            raise TimeoutError(text) from None
        except OSError:
            line = b""
        except BaseException:  # an interrupt: the pending answer would be read as that to the next message
            self.end()
            raise
        if not line.endswith(b"\n"):
            self.end()
            raise ProcessEnded(f"{self._name} ended in {message['do']}{self._read_log()}")
        try:
            answer = json.loads(line)
        except ValueError:
            answer = None
        if not isinstance(answer, dict):
            self.end()
            raise UsageError(
                f"{self._name} answered {line[:80]!r} to {message['do']}, which is not a JSON object",
                "print all else on standard error, or use `connect: socket`",
            )
        if "error" in answer:
            raise RuntimeError(f"{self._name}: {answer['error']}")
        return answer

    def _read_log(self) -> str:
        self._log.seek(0)
        text = self._log.read().decode(errors="replace").strip()
        longest = 300
        return f": ...{text[-longest:]}" if len(text) > longest else f": {text}" if text else ""


def _start(config: ProcessConfig, log: Any) -> tuple[socket.socket, subprocess.Popen[bytes]]:
    ours, theirs = socket.socketpair()
    with theirs:
        try:
            # New session: an interrupt reaches only the owner, and programs that it starts end with it.
            return ours, subprocess.Popen(
                config.command,
                stdin=theirs.fileno(),
                stdout=theirs.fileno(),
                stderr=log,
                start_new_session=True,
            )
        except OSError:
            ours.close()
            raise


def _listen(config: ProcessConfig, log: Any) -> tuple[socket.socket, subprocess.Popen[bytes]]:
    with socket.create_server(("127.0.0.1", 0)) as server:
        child = subprocess.Popen(
            config.command,
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=log,
            env={**os.environ, "AVRARE_PORT": str(server.getsockname()[1])},
            start_new_session=True,
        )
        server.settimeout(0.1)
        end = time.monotonic() + config.start_timeout
        while time.monotonic() < end and child.poll() is None:
            with contextlib.suppress(TimeoutError):
                connection, _ = server.accept()
                connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                return connection, child
    _kill(child)
    raise OSError("it did not connect to the port in AVRARE_PORT")


def _end(connection: socket.socket, child: subprocess.Popen[bytes]) -> None:
    with contextlib.suppress(OSError):
        connection.settimeout(0.1)
        connection.sendall(b'{"do": "bye"}\n')
        connection.shutdown(socket.SHUT_RDWR)
    connection.close()
    with contextlib.suppress(subprocess.TimeoutExpired):
        child.wait(0.2)
    _kill(child)


def _kill(child: subprocess.Popen[bytes]) -> None:
    with contextlib.suppress(OSError):  # all that it has started
        os.killpg(child.pid, signal.SIGKILL)
    child.wait()
