"""Simulator ``transformed``: any other simulator, with noise that is not normal."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from avrare.base.errors import PluginError, UsageError
from avrare.plugin.registry import default_registry
from avrare.protocols import Bools, Floats, Signals, Simulator
from avrare.scenario.validation import check_options
from avrare_flows import composite_laws, marginals
from avrare_flows.config import LawConfig, RestrictableLaw, TransformedConfig
from avrare_flows.laws import Joint, Law
from avrare_flows.marginals import Marginal
from avrare_flows.system import check_size, list_warnings

_NAMES: dict[str, Callable[..., Marginal]] = {
    "normal": marginals.Normal,
    "lognormal": marginals.LogNormal,
    "exponential": marginals.Exponential,
    "weibull": marginals.Weibull,
    "gamma": marginals.Gamma,
    "gumbel": marginals.Gumbel,
    "student_t": marginals.StudentT,
    "uniform": marginals.Uniform,
    "point": composite_laws.Point,
    "beam": composite_laws.beam,
}


def build(config: TransformedConfig, scene: object | None = None) -> TransformedSimulator:
    """Build the simulator of a scenario.

    Raises:
        PluginError: No plugin provides the other simulator, or it cannot be loaded.
        UsageError: Its options, a law or the number of laws do not fit, or it has no noise.
    """
    inner = _build_inner(config.simulator)
    if isinstance(inner, TransformedSimulator):  # it takes normal numbers, and would get others
        raise UsageError("transformed cannot hold another transformed", "give all laws in one of them")
    if inner.noise_size == 0:
        raise UsageError(f"simulator {config.simulator['plugin']!r} has no noise to transform")
    law: Law
    if config.flow is not None:
        from avrare_flows.flow import Flow

        law = Flow.load(config.flow)
    else:
        law = _joint(config.noise or (), inner.noise_size, config.correlation)
    first = law if config.initial is None else _joint(config.initial, inner.noise_size)
    for checked in (law, first):
        check_size(checked, inner.noise_size)
    return TransformedSimulator(inner, law, first)


class TransformedSimulator(Simulator):
    """Simulator that hands physical noise to another one.

    Attributes:
        simulator: The other simulator.
        dt: Its time step [s].
        noise_size: Its noise size.
        warnings: Health warnings for every result.
    """

    def __init__(self, simulator: Simulator, law: Law, first: Law) -> None:
        self.simulator, self.law, self.first = simulator, law, first
        self.dt, self.noise_size = simulator.dt, simulator.noise_size
        self.warnings = list_warnings(law, first)
        self.scene = simulator.scene

    def check_steps(self, steps: int) -> None:
        """Raise the ``UsageError`` of the other simulator."""
        self.simulator.check_steps(steps)

    def reset(self, noise: Floats) -> Any:
        """Return the world at t = 0."""
        return self.simulator.reset(self.first.physical(noise))

    def step(self, world: object, action: object, noise: Floats) -> Any:
        """Return the world one step later."""
        return self.simulator.step(world, action, self.law.physical(noise))

    def signals(self, world: object) -> Signals:
        """Return the signals of the other simulator."""
        return self.simulator.signals(world)

    def faults(self, world: object) -> Bools | None:
        """Return the rows (N,) of the other simulator that have broken down."""
        return self.simulator.faults(world)


def _build_inner(block: dict[str, object]) -> Simulator:
    name = str(block["plugin"])
    component = default_registry().require("simulator", name)
    options = {key: value for key, value in block.items() if key != "plugin"}
    config = check_options(component.load_config(), name, options, "simulator")
    try:
        simulator: Simulator = component.build(config)
        return simulator
    except ImportError as error:
        raise PluginError(f"simulator {name!r} cannot be loaded: {error}") from error


def _joint(configs: tuple[LawConfig, ...], size: int, correlation: Any = None) -> Joint:
    laws = [law_of(config) for config in configs]
    return Joint(laws * size if len(laws) == 1 else laws, correlation)


def law_of(config: LawConfig) -> Marginal:
    """Return the law that a scenario describes.

    Raises:
        UsageError: SciPy has no such distribution, or a law has no probability between its ends.
    """
    if config.law == "scipy":
        law: Marginal = _scipy_law(config.name, config.options)
    elif config.law == "mixture":
        law = composite_laws.Mixture(config.weights, tuple(law_of(part) for part in config.laws))
    else:
        cut = () if config.law == "uniform" else ("low", "high")
        law = _NAMES[config.law](**config.model_dump(exclude={"law", *cut}))
    if not isinstance(config, RestrictableLaw):
        return law
    ends = {name: end for name, end in (("low", config.low), ("high", config.high)) if end is not None}
    return composite_laws.Truncated(law, **ends) if ends else law


def _scipy_law(name: str, options: dict[str, float]) -> composite_laws.Scipy:
    from scipy import stats

    family = getattr(stats, name, None)
    if not isinstance(family, stats.rv_continuous):
        raise UsageError(f"scipy.stats has no continuous distribution {name!r}")
    try:
        frozen = family(**options)
    except TypeError as error:
        raise UsageError(f"scipy.stats.{name}: {error}") from error
    if not frozen.ppf(0.5) == frozen.ppf(0.5):
        raise UsageError(f"scipy.stats.{name}: it has no distribution with {options}")
    return composite_laws.Scipy(frozen)
