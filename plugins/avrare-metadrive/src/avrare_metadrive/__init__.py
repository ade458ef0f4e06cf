"""MetaDrive as a simulator, and the driver that it ships."""

from avrare.plugin import Component, hookimpl
from avrare_metadrive.version import check_supported


@hookimpl
def avrare_components() -> list[Component]:
    """Return descriptions of the simulator and the controller.

    Raises:
        PluginError: An unsupported version of MetaDrive is installed.
    """
    check_supported(optional=True)
    return [
        Component(
            kind="simulator",
            name="metadrive",
            config="avrare_metadrive.config:MetaDriveConfig",
            factory="avrare_metadrive.world:build",
            summary="MetaDrive with a noisy lidar, without the asset download",
            needs=("metadrive", "scipy"),
        ),
        Component(
            kind="controller",
            name="metadrive_expert",
            config="avrare_metadrive.config:ExpertConfig",
            factory="avrare_metadrive.expert:build",
            summary="MetaDrive's expert driver, in NumPy",
            needs=("metadrive",),
        ),
    ]
