"""Learnt policies as controllers: a small network from an ``.npz`` file, run in NumPy."""

from avrare.plugin import Component, hookimpl


@hookimpl
def avrare_components() -> list[Component]:
    """Return the controller ``policy``."""
    return [
        Component(
            kind="controller",
            name="policy",
            config="avrare_policy.config:PolicyConfig",
            factory="avrare_policy.controller:build",
            summary="a neural network from an .npz or .onnx file, for simulators that hand out observations",
        )
    ]
