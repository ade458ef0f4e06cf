"""Splitting in the variant that the options ask for."""

from __future__ import annotations

from avrare_estimators.ams.config import AmsConfig
from avrare_estimators.ams.splitting import Splitting
from avrare_estimators.ams.stl_ams import PublishedSplitting


def build(config: AmsConfig, scene: object | None = None) -> Splitting:
    """Build the estimator of a scenario or a call."""
    return PublishedSplitting(config) if config.variant == "published" else Splitting(config)
