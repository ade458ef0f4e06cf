"""MetaDrive as a simulator, and the driver that comes with it."""

from avrare.plugin import Component, hookimpl
from avrare_metadrive.version import refuse_others


@hookimpl
def avrare_components() -> list[Component]:
    """The simulator and the controller of this distribution.

    Raises:
        PluginError: Another version of MetaDrive is installed than the one they are made for.
    """
    refuse_others()
    return [
        Component(
            kind="simulator",
            name="metadrive",
            config="avrare_metadrive.config:MetaDriveConfig",
            factory="avrare_metadrive.world:build",
            summary="MetaDrive without its asset download, behind a noisy lidar",
            needs=("metadrive", "scipy"),
        ),
        Component(
            kind="controller",
            name="metadrive_expert",
            config="avrare_metadrive.config:ExpertConfig",
            factory="avrare_metadrive.expert:build",
            summary="the driver that MetaDrive ships, in NumPy",
            needs=("metadrive",),
        ),
    ]
