"""Descriptions that plugins give the core: components, the rules that they offer, and findings of checks.

A component is described by names and import strings, so listing and validating import nothing heavy:
``config`` is imported to check a scenario, ``factory`` only to build the component.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any

import pluggy

from avrare.plugin.options import Options

if TYPE_CHECKING:
    from avrare.driving import Scene

CHARTS = "avrare.estimation.result.charts:draw_charts"
"""Charts of estimators that declare none."""
KINDS = ("simulator", "perception", "tracker", "controller", "specification", "estimator", "executor")


@dataclass(frozen=True)
class Finding:
    """Mistake or warning in the options of a component.

    Attributes:
        message: Message; several lines where a formula is shown with a mark.
        hint: Advice.
        option: The option concerned; None for the component itself.
        is_error: True if the scenario cannot be used, False for a warning.
    """

    message: str
    hint: str | None = None
    option: str | None = None
    is_error: bool = True


@dataclass(frozen=True)
class RuleParameter:
    """Number or choice that a rule depends on.

    Attributes:
        name: Name of the option in a scenario.
        default: Default value, as written in a scenario.
        unit: For example ``m/s``; empty for a pure number or a choice.
        text: Meaning of the parameter.
        source: Source of the default value.
    """

    name: str
    default: str
    unit: str
    text: str
    source: str


@dataclass(frozen=True)
class RuleCard:
    """Traffic rule as shown to people.

    Attributes:
        name: Name in scenarios, for example ``R_G1``.
        title: A few words.
        text: The rule in English.
        formula: The rule in the language of ``avrare.stl``, with the default parameters filled in.
        parameters: Options that the rule depends on.
        source: Source of the rule.
        remarks: How details of the rule are read.
    """

    name: str
    title: str
    text: str
    formula: str
    parameters: tuple[RuleParameter, ...]
    source: str
    remarks: str = ""


@dataclass(frozen=True)
class CheckRole:
    """Role of an estimator that can cross-check estimates of other families.

    Attributes:
        order: Of two estimators that can check, the one with the smaller number does.
        first_for: Families whose estimates it checks before all others, whatever their numbers.
    """

    order: int
    first_for: tuple[str, ...] = ()


@dataclass(frozen=True)
class AutoRole:
    """Role of an estimator that ``auto`` may choose where failures are too rare for Monte Carlo.

    Attributes:
        order: Candidates with smaller numbers are tried first.
        with_steps: True: for problems with steps only; False: for those without; None: for both.
        gives_up: The estimator raises ``GaveUp`` where it gains nothing, before any rollout counts. Any other
            candidate has ``scale``, and is chosen where a small trial of it promises a gain.
        options: ``"package.module:function"``, called as ``function(relative_error, pilot)`` with the error
            to reach (None: the rollouts are spent) and the most rollouts of a pilot; returns further options.
            ``relative_error`` and ``memory`` are given to estimators that have them. Must import nothing
            heavy.
    """

    order: int
    with_steps: bool | None = None
    gives_up: bool = False
    options: str = ""

    def fits(self, steps: int) -> bool:
        """Return whether it is a candidate for problems with this number of steps."""
        return self.with_steps in (None, steps > 0)


@dataclass(frozen=True)
class FoundScene:
    """Scene of a file, or several that differ in the values of some options.

    Attributes:
        path: The file.
        options: Options of the simulator.
        axes: Choices that multiply; each is a list of the options, as written, that it sets.
    """

    path: str
    options: Mapping[str, object]
    axes: tuple[tuple[Mapping[str, str], ...], ...] = ()


@dataclass(frozen=True)
class Component:
    """Part that a scenario can name with ``plugin:``.

    Attributes:
        kind: One of ``KINDS``.
        name: Name after ``plugin:`` in a scenario.
        config: ``"package.module:Class"`` of a class of ``Options``; must import nothing heavy.
        factory: ``"package.module:function"``, called as ``factory(config, scene)``; ``scene`` is the
            simulator's ``Scene`` (None for simulators, for estimators, and if the simulator has none).
        summary: One line for ``avrare plugins``.
        needs: Modules that the factory imports beyond NumPy.
        api: Version of the plugin interface that the plugin was written for.
        rules: ``"package.module:function"`` returning a list of ``RuleCard``, for a specification that offers
            rules by name (its option ``rule``); otherwise empty. Must import nothing heavy.
        check: ``"package.module:function"`` that finds mistakes which the model of a specification's options
            cannot see: called as ``check(config, dt)`` when a scenario is loaded, with the simulator's step
            [s] or None if not known; returns a list of ``Finding``. Must import nothing heavy.
        complete: ``"package.module:function"`` of a simulator whose options are partly in files of others:
            called as ``complete(options, folder)`` when a scenario is loaded, with the options as written and
            the folder that their paths may be relative to; returns options to add or to put in their place,
            laws among them. Raises a ``UsageError`` where the file is wrong. Must import nothing heavy.
        scenes: ``"package.module:function"`` of a simulator whose scenes are files of others: called as
            ``scenes(path, ego)`` with a file or folder and the name of the ego (None: the default), it
            returns a list of ``FoundScene``, for ``avrare new catalogue``.
        driving: True for components of road vehicles; they are refused if the simulator has no ``Scene``.
        warnings: Health warnings that the component may raise, name to text; a scenario may suppress them.
            A text may have {placeholders} (``avrare.base.health_messages.fill``).
        family: Method of an estimator: estimators of one family do not cross-check each other. Default: its
            name.
        cross_check: Role of an estimator in cross-checks; it then has ``scale``. None: it checks no others.
        auto: Role of an estimator in ``auto``; None: it is never chosen.
        shares_rollouts: True for an estimator that judges all specifications on the same rollouts: a budget
            for several is not divided among them.
        charts: ``"package.module:function"`` that draws an estimator's results for the report: called with a
            ``Result``, it returns a tuple of ``avrare.base.chart.Chart``. Default: a histogram of robustness,
            and the convergence over several runs.
    """

    kind: str
    name: str
    config: str
    factory: str
    summary: str
    needs: tuple[str, ...] = ()
    api: int = 1
    rules: str = ""
    check: str = ""
    complete: str = ""
    scenes: str = ""
    driving: bool = False
    warnings: Mapping[str, str] = field(default_factory=dict, hash=False)
    family: str = ""
    cross_check: CheckRole | None = None
    auto: AutoRole | None = None
    charts: str = CHARTS
    shares_rollouts: bool = False

    def __post_init__(self) -> None:
        """Take the name for the family where none is given."""
        object.__setattr__(self, "family", self.family or self.name)

    def load_config(self) -> type[Options]:
        """Import the class of the options."""
        model = resolve_name(self.config)
        if not (isinstance(model, type) and issubclass(model, Options)):
            raise TypeError(f"{self.config} is not a class derived from avrare.plugin.Options")
        return model

    def load_factory(self) -> Callable[..., Any]:
        """Import the function that builds the component; may import heavy packages."""
        factory: Callable[..., Any] = resolve_name(self.factory)
        return factory

    def build(self, config: object, scene: Scene | None = None) -> Any:
        """Build the part; it has the members of its kind's base class (``avrare.protocols``)."""
        from avrare.protocols import BASES, adapt  # NumPy, which listing and validating do without

        return adapt(BASES[self.kind], self.load_factory()(config, scene))

    def load_rules(self) -> list[RuleCard]:
        """Return the rules that the component offers by name, if any."""
        return list(resolve_name(self.rules)()) if self.rules else []

    def find_faults(self, config: object, dt: float | None) -> list[Finding]:
        """Run the check that the component defines for its options, if any."""
        return list(resolve_name(self.check)(config, dt)) if self.check else []


GROUP = "avrare"
"""Entry-point group and pluggy project name."""

API_VERSION = 1

hookspec = pluggy.HookspecMarker(GROUP)
hookimpl = pluggy.HookimplMarker(GROUP)


class HookSpecs:
    """Hooks called by avrare."""

    @hookspec
    def avrare_components(self) -> list[Component]:  # type: ignore[empty-body]
        """Return descriptions of the plugin's components. Must import nothing heavy."""
