"""The kernels by name."""

from __future__ import annotations

from avrare_estimators.chains import Kernel
from avrare_estimators.ess_config import EssConfig


def kernel_of(config: EssConfig) -> Kernel:
    """The kernel that the options ask for; only what is used is imported."""
    match config.kernel:
        case "shrink":
            from avrare_estimators.shrink import ShrinkKernel

            return ShrinkKernel() if config.bracket is None else ShrinkKernel(config.bracket)
        case "lipschitz" | "lipschitz_growing":
            from avrare_estimators.lipschitz import GrowingLipschitzKernel, LipschitzKernel

            if config.kernel == "lipschitz_growing":
                return GrowingLipschitzKernel(config.lipschitz or 1.0)
            assert config.lipschitz is not None
            return LipschitzKernel(config.lipschitz)
        case "surrogate":
            from avrare_estimators.surrogate import SurrogateKernel

            return SurrogateKernel()
        case "bayesian":
            from avrare_estimators.bayesian import BayesianKernel

            return BayesianKernel()
        case "pcn":
            from avrare_estimators.pcn import PcnKernel

            return PcnKernel()
