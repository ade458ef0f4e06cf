"""Noise that is not normal: isoprobabilistic transforms, copulas and normalising flows."""

from typing import TYPE_CHECKING, Any

from avrare.plugin import Component, hookimpl
from avrare_flows.health_messages import WARNINGS

if TYPE_CHECKING:
    from avrare_flows.system import transform_noise as transform_noise
    from avrare_flows.weights import weigh_noise as weigh_noise

_PUBLIC = {"transform_noise": "avrare_flows.system", "weigh_noise": "avrare_flows.weights"}


@hookimpl
def avrare_components() -> list[Component]:
    """Return the simulator of this distribution."""
    return [
        Component(
            kind="simulator",
            name="transformed",
            config="avrare_flows.config:TransformedConfig",
            factory="avrare_flows.simulator:build",
            summary="any other simulator, with noise that is not normal",
            needs=("scipy",),
            warnings=WARNINGS,
        ),
    ]


def __getattr__(name: str) -> Any:
    """Import ``transform_noise`` and ``weigh_noise``, which need SciPy, on first use."""
    import importlib

    if name not in _PUBLIC:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(_PUBLIC[name]), name)
