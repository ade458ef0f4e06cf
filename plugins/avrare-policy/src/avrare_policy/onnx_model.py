"""Policies in ONNX files, run by onnxruntime."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from avrare.base.errors import PluginError, UsageError
from avrare.base.stored_files import read_regular
from avrare_policy.network import Floats

if TYPE_CHECKING:
    from onnxruntime import InferenceSession


class OnnxPolicy:
    """Policy from observation (N, D) to action (N, A): the first output of an ONNX model.

    The products of a batch may depend in their last bits on its size. Where they do, on random rows that are
    tried first, rows run one by one, so that a rollout has the same bits in any batch.

    Attributes:
        inputs: Numbers of an observation, D.
        one_by_one: Whether rows run one by one.

    Raises:
        PluginError: onnxruntime is not installed.
        UsageError: The file is another model.
    """

    def __init__(self, path: Path) -> None:
        try:
            import onnxruntime
        except ImportError:
            raise PluginError(f"{path}: needs onnxruntime", "pip install 'avrare-policy[onnx]'") from None
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.log_severity_level = 4
        try:
            model = read_regular(path)
            self._session = onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])
        except Exception as error:  # onnxruntime has many, without a common base
            raise UsageError(f"{path}: not an ONNX model: {_first_line(error)}") from None
        self._name, self._type, self.inputs, fixed = _read_input(path, self._session)
        self._output = self._session.get_outputs()[0].name
        self.one_by_one = fixed or not self._agrees_across_batches(path)

    def __call__(self, observation: Floats) -> Floats:
        """Return actions (N, A) of observations (N, D)."""
        rows = np.asarray(observation, dtype=self._type)
        if not self.one_by_one or len(rows) == 1:
            return self._run(rows)
        return np.concatenate([self._run(rows[k : k + 1]) for k in range(len(rows))])

    def __reduce__(self) -> tuple[object, ...]:
        raise TypeError("an ONNX session cannot be copied to another process; build the scenario there")

    def _run(self, rows: Any) -> Floats:
        (action,) = self._session.run([self._output], {self._name: rows})
        return np.asarray(action, dtype=np.float64).reshape(len(rows), -1)

    def _agrees_across_batches(self, path: Path) -> bool:
        trials = 64
        rows = np.random.default_rng(0).standard_normal((trials, self.inputs)).astype(self._type)
        try:
            whole = self._run(rows)
            return all(
                np.array_equal(self._run(rows[at : at + size]), whole[at : at + size])
                for size in (1, 2, 3, 5, 8, 13, 31, 64)
                for at in range(0, trials, size)
            )
        except Exception as error:
            raise UsageError(
                f"{path}: the model fails on random observations: {_first_line(error)}"
            ) from None


def _read_input(path: Path, session: InferenceSession) -> tuple[str, Any, int, bool]:
    inputs = session.get_inputs()
    if len(inputs) != 1:
        names = ", ".join(input_.name for input_ in inputs)
        raise UsageError(
            f"{path}: the model has {len(inputs)} inputs ({names}), a policy has one: the observation"
        )
    (entry,) = inputs
    types = {"tensor(float)": np.float32, "tensor(double)": np.float64}
    if entry.type not in types or len(entry.shape) != 2 or not isinstance(entry.shape[1], int):
        raise UsageError(
            f"{path}: the input {entry.name} is {entry.type} {entry.shape}, not floats (rows, numbers)",
            "export the model with an input of shape (batch, D) and a dynamic batch axis",
        )
    return entry.name, types[entry.type], entry.shape[1], isinstance(entry.shape[0], int)


def _first_line(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]
