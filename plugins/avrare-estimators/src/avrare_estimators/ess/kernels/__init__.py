"""Markov kernels of elliptical slice sampling, by name."""

from __future__ import annotations

from avrare_estimators.config import EssConfig
from avrare_estimators.ess.chains import Kernel
from avrare_estimators.ess.kernels.bayesian import Acquisition, BayesianKernel
from avrare_estimators.ess.kernels.lipschitz import GrowingLipschitzKernel, LipschitzKernel
from avrare_estimators.ess.kernels.pcn import PcnKernel
from avrare_estimators.ess.kernels.shrink import ShrinkKernel
from avrare_estimators.ess.kernels.surrogate import SurrogateKernel


def make_kernel(config: EssConfig) -> Kernel:
    """Make the kernel that the options ask for."""
    match config.kernel:
        case "shrink":
            return ShrinkKernel() if config.bracket is None else ShrinkKernel(config.bracket)
        case "lipschitz":
            assert config.lipschitz is not None
            return LipschitzKernel(config.lipschitz)
        case "lipschitz_growing":
            return GrowingLipschitzKernel(config.lipschitz or 1.0)
        case "surrogate":
            return SurrogateKernel()
        case "bayesian":
            acquisition = Acquisition(config.acquisition, config.kappa, config.xi)
            return BayesianKernel(acquisition, config.points, config.uncertainty)
        case "pcn":
            return PcnKernel()
