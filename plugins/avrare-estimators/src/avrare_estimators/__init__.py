"""Rare-event estimators: adaptive multilevel splitting."""

from avrare.plugin import Component, hookimpl


@hookimpl
def avrare_components() -> list[Component]:
    """The estimators of this distribution."""
    return [
        Component(
            kind="estimator",
            name="ams",
            config="avrare_estimators.config:AmsConfig",
            factory="avrare_estimators.splitting:build",
            summary="adaptive multilevel splitting, unbiased for any formula",
        )
    ]
