"""Gymnasium environments as simulators, and simple controllers for them."""

from avrare.plugin import Component, hookimpl


@hookimpl
def avrare_components() -> list[Component]:
    """Return descriptions of the simulator and the controllers."""
    return [
        Component(
            kind="simulator",
            name="gymnasium",
            config="avrare_gymnasium.config:GymnasiumConfig",
            factory="avrare_gymnasium.world:build",
            summary="any registered Gymnasium environment, driven by the noise tape",
            needs=("gymnasium",),
        ),
        Component(
            kind="controller",
            name="gym_feedback",
            config="avrare_gymnasium.config:FeedbackConfig",
            factory="avrare_gymnasium.controllers:build_feedback",
            summary="linear feedback on the observation",
        ),
        Component(
            kind="controller",
            name="gym_constant",
            config="avrare_gymnasium.config:ConstantConfig",
            factory="avrare_gymnasium.controllers:build_constant",
            summary="the same action at every step",
        ),
    ]
