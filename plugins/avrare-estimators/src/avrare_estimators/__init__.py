"""Rare-event estimators: multilevel splitting, slice sampling, importance sampling, cross-entropy."""

from avrare.plugin import AutoRole, CheckRole, Component, hookimpl
from avrare_estimators.common.health_messages import WARNINGS

LEVEL_CHARTS = "avrare_estimators.common.level_charts:draw_charts"


@hookimpl
def avrare_components() -> list[Component]:
    """Return the estimators of this distribution."""
    return [
        Component(
            kind="estimator",
            name="ams",
            config="avrare_estimators.ams.config:AmsConfig",
            factory="avrare_estimators.ams.build:build",
            summary="adaptive multilevel splitting, unbiased for any formula",
            warnings=WARNINGS,
            cross_check=CheckRole(order=20, first_for=("ess", "mc")),
            auto=AutoRole(order=20, with_steps=True),
            charts=LEVEL_CHARTS,
        ),
        Component(
            kind="estimator",
            name="ess",
            config="avrare_estimators.ess.config:EssConfig",
            factory="avrare_estimators.ess.build:build",
            summary="nested levels with Markov chains on the noise: elliptical slices or pCN",
            warnings=WARNINGS,
            cross_check=CheckRole(order=10),
            auto=AutoRole(order=30, options="avrare_estimators.ess.auto_options:choose_options"),
            charts=LEVEL_CHARTS,
        ),
        Component(
            kind="estimator",
            name="is",
            config="avrare_estimators.importance.config:IsConfig",
            factory="avrare_estimators.importance.build:build",
            summary="importance sampling from a law of the noise or another perception model",
            warnings=WARNINGS,
            auto=AutoRole(
                order=10, gives_up=True, options="avrare_estimators.importance.config:choose_auto_options"
            ),
        ),
        Component(
            kind="estimator",
            name="ce",
            config="avrare_estimators.ce.config:CeConfig",
            factory="avrare_estimators.ce.cross_entropy:build",
            summary="cross-entropy: learns, with torch, how to tilt perception towards failures",
            warnings=WARNINGS,
        ),
        Component(
            kind="estimator",
            name="mfmc",
            config="avrare_estimators.two_fidelities.config:MfmcConfig",
            factory="avrare_estimators.two_fidelities.estimator:build",
            summary="two fidelities: a cheap twin on many tapes, the stack itself on those that matter",
            shares_rollouts=True,
        ),
        Component(
            kind="estimator",
            name="smc",
            config="avrare_estimators.smc.config:SmcConfig",
            factory="avrare_estimators.smc.estimator:build",
            summary="sequential Monte Carlo with potentials and a proposal that are learned",
            warnings=WARNINGS,
            auto=AutoRole(order=40, with_steps=True),
        ),
    ]
