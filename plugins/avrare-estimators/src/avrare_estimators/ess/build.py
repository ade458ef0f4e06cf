"""Nested levels with the kernel that the options ask for."""

from __future__ import annotations

from avrare_estimators.common.chains.kernel import Kernel
from avrare_estimators.common.chains.pcn import PcnKernel
from avrare_estimators.ess.config import (
    BayesianConfig,
    EssConfig,
    GrowingLipschitzConfig,
    KernelConfig,
    LipschitzConfig,
    PcnConfig,
    ShrinkConfig,
)
from avrare_estimators.ess.estimator import NestedLevels
from avrare_estimators.ess.kernels.lipschitz import LipschitzKernel
from avrare_estimators.ess.kernels.shrink import ShrinkKernel
from avrare_estimators.ess.kernels.stl_ess import Acquisition, BayesianKernel, GrowingLipschitzKernel


def build(config: EssConfig, scene: object | None = None) -> NestedLevels:
    """Build the estimator of a scenario or a call."""
    return NestedLevels(config, build_kernel(config.kernel))


def build_kernel(options: KernelConfig) -> Kernel:
    """Build a kernel from its options."""
    match options:
        case PcnConfig():
            return PcnKernel()
        case ShrinkConfig(bracket=width):
            return ShrinkKernel(width)
        case LipschitzConfig(bound=slope):
            return LipschitzKernel(slope)
        case GrowingLipschitzConfig(guess=slope):
            return GrowingLipschitzKernel(slope)
        case BayesianConfig(acquisition=acquisition, points=points, uncertainty=uncertainty):
            return BayesianKernel(Acquisition(**acquisition.model_dump()), points, uncertainty)
