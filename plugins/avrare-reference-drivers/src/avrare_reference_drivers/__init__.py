"""Reference drivers of UN R157, the bound of EU 2022/1426, and plain stacks to compare with them."""

from avrare.plugin import Component, hookimpl


@hookimpl
def avrare_components() -> list[Component]:
    """Return descriptions of the controllers and the specification."""
    return [
        Component(
            kind="controller",
            name="reference_driver",
            config="avrare_reference_drivers.config:ReferenceDriverConfig",
            factory="avrare_reference_drivers.reference_driver:build",
            summary="careful human driver, R157 5.2.5.2, RSS or fuzzy safety model, which keep their lane",
            driving=True,
        ),
        Component(
            kind="controller",
            name="cruise",
            config="avrare_reference_drivers.config:CruiseConfig",
            factory="avrare_reference_drivers.cruise:build_cruise",
            summary="set speed and following distance of R157 5.2.3.3",
            driving=True,
        ),
        Component(
            kind="controller",
            name="hold",
            config="avrare_reference_drivers.config:HoldConfig",
            factory="avrare_reference_drivers.cruise:build_hold",
            summary="a given speed along a given path",
            driving=True,
        ),
        Component(
            kind="specification",
            name="avoidable_collision",
            config="avrare_reference_drivers.config:AvoidableCollisionConfig",
            factory="avrare_reference_drivers.avoidable_collision:build",
            summary="no collision with a car that cuts in early enough by EU 2022/1426",
            driving=True,
        ),
    ]
