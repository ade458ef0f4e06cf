"""Linear systems with Gaussian noise: simulator, exact elliptical slices, and synthesis."""

from avrare.plugin import Component, hookimpl
from avrare_estimators.common.health_messages import WARNINGS


@hookimpl
def avrare_components() -> list[Component]:
    """Return the simulator and the estimator of this distribution."""
    return [
        Component(
            kind="simulator",
            name="linear",
            config="avrare_linear.config:LinearConfig",
            factory="avrare_linear.simulator:build",
            summary="linear system with Gaussian noise, observer and feedback",
            needs=("scipy",),
        ),
        Component(
            kind="estimator",
            name="ess_linear",
            config="avrare_linear.estimator_config:LinearEssConfig",
            factory="avrare_linear.estimator:build",
            summary="nested levels with exact ellipse slices, for linear systems and predicates",
            warnings=WARNINGS,
            family="ess",
            charts="avrare_estimators.common.level_charts:draw_charts",
        ),
    ]
