"""A perception error model in closed form, free of licensed data.

Detection falls logistically with range; errors are Student-t with a scale that grows with range. The default
coefficients were fitted to a PointPillar lidar detector on vehicles oblique to the ego, range below 60 m.

Occlusion multiplies detection by min(1, visible fraction / full_visibility): a detector hardly notices a
little occlusion (on KITTI 0.77 of unoccluded and 0.75 of partly occluded vehicles are detected, 0.63 of
largely occluded ones), and nothing can be detected that sends no echo.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from avrare.driving import Scene, World
from avrare_gp_pem.config import ParametricPemConfig
from avrare_gp_pem.law import ErrorLaw, LawPem
from avrare_gp_pem.persistence import PersistentPem, lasting
from avrare_gp_pem.relative import relative
from avrare_gp_pem.visibility import visibility

Floats = NDArray[np.float64]
_STEEPEST = 700.0  # exp of this is still finite


@dataclass(frozen=True)
class ParametricPem(LawPem):
    """Logistic detection and Student-t errors.

    Attributes:
        config: Coefficients.
        scene: Sizes of the other vehicles.
    """

    config: ParametricPemConfig
    scene: Scene

    def law(self, world: World) -> ErrorLaw:
        """The distribution of the observation of ``world``."""
        config, distance = self.config, relative(world).range
        steepness = (distance - config.detection_range) / config.detection_width
        in_range = config.detection_plateau / (1 + np.exp(np.minimum(steepness, _STEEPEST)))
        seen = visibility(world, self.scene, config.rays)
        detect = in_range * np.minimum(1.0, seen / config.full_visibility)
        scales = [
            base + slope * distance for base, slope in (config.longitudinal_scale, config.lateral_scale)
        ]
        scale = np.stack(scales, axis=-1)
        return ErrorLaw(
            detect=detect,
            miss=1 - detect,
            location=np.zeros_like(scale),
            scale=scale,
            dof=(config.longitudinal_dof, config.lateral_dof),
            limit=config.error_limit,
            speed_sd=config.speed_sd,
        )


def build_parametric(config: ParametricPemConfig, scene: Scene) -> ParametricPem | PersistentPem:
    """The parametric model for a scene."""
    return lasting(ParametricPem(config, scene), config.persistence, scene)
