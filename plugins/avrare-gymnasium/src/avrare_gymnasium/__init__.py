"""Gymnasium environments as simulators, and plain controllers for them."""

from avrare.plugin import Component, hookimpl


@hookimpl
def avrare_components() -> list[Component]:
    """The simulator and the controllers of this distribution."""
    return [
        Component(
            kind="simulator",
            name="gymnasium",
            config="avrare_gymnasium.config:GymnasiumConfig",
            factory="avrare_gymnasium.simulator:build",
            summary="any registered Gymnasium environment, with noise from outside",
            needs=("gymnasium",),
        ),
        Component(
            kind="controller",
            name="gym_feedback",
            config="avrare_gymnasium.controller_config:FeedbackConfig",
            factory="avrare_gymnasium.controllers:build_feedback",
            summary="linear feedback on the observation",
        ),
        Component(
            kind="controller",
            name="gym_constant",
            config="avrare_gymnasium.controller_config:ConstantConfig",
            factory="avrare_gymnasium.controllers:build_constant",
            summary="the same action at every step",
        ),
    ]
