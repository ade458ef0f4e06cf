"""Worlds and models that the tests share."""

import pytest

from perception_scenes import make, pointpillars

__all__ = ["make", "pointpillars"]


@pytest.fixture(params=["gp_pem", "parametric"])
def build(request):
    """Return a function of (scene, **options) that builds either model the way a scenario does."""
    import avrare_gp_pem

    component = next(c for c in avrare_gp_pem.avrare_components() if c.name == request.param)
    return lambda scene, **options: component.load_factory()(component.load_config()(**options), scene)
