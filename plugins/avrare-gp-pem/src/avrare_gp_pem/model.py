"""A perception error model learnt from a real detector: Gaussian processes or networks."""

from __future__ import annotations

from dataclasses import dataclass

from avrare.driving import Scene, World
from avrare.errors import UsageError
from avrare_gp_pem.config import GpPemConfig
from avrare_gp_pem.features import box_of
from avrare_gp_pem.law import ErrorLaw, LawPem
from avrare_gp_pem.persistence import PersistentPem, lasting
from avrare_gp_pem.relative import relative
from avrare_gp_pem.store import FittedPem, load, locate
from avrare_gp_pem.variant import Variant
from avrare_gp_pem.visibility import category, visibility


@dataclass(frozen=True)
class GpPem(LawPem):
    """Detections and position errors as a fit to a detector predicts them.

    Attributes:
        config: Options.
        scene: Sizes of the other vehicles.
        variant: The fitted law.
    """

    config: GpPemConfig
    scene: Scene
    variant: Variant

    def law(self, world: World) -> ErrorLaw:
        """The distribution of the observation of ``world``."""
        levels = category(visibility(world, self.scene, self.config.rays))
        box = box_of(relative(world), self.scene.lengths, self.scene.widths, self.config.height, levels)
        return self.variant.law(box, self.config.speed_sd)


def build_gp(config: GpPemConfig, scene: Scene) -> GpPem | PersistentPem:
    """The fitted model for a scene.

    Raises:
        UsageError: The model is unknown, its file cannot be read, or it knows no artefact that is asked for.
    """
    variant = choose(load(locate(config.model)), config.artefact, config.model)
    return lasting(GpPem(config, scene, variant), config.persistence, scene)


def choose(fitted: FittedPem, artefact: bool, name: str) -> Variant:
    """The detector, or with ``artefact`` its labels as delivered.

    Raises:
        UsageError: The model called ``name`` was fitted to labels without an artefact.
    """
    if not artefact:
        return fitted.clean
    if fitted.delivered is None:
        raise UsageError(f"perception model {name!r} knows no artefact of matching", "leave artefact: false")
    return fitted.delivered
