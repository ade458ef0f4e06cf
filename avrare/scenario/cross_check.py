"""Key ``cross_check`` of scenarios."""

from __future__ import annotations

from typing import Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from avrare.base.errors import PluginError
from avrare.plugin.registry import default_registry
from avrare.scenario.validation import error_with_hint


def _checker(name: str) -> str:
    try:
        component = default_registry().get("estimator", name)
    except PluginError as error:
        raise error_with_hint(error.message, error.hint) from None
    if component.cross_check is None:
        names = ", ".join(checker.name for checker in default_registry().checkers())
        raise error_with_hint(f"estimator {name!r} checks no others", f"estimators that do: {names}")
    return name


class CrossCheck(BaseModel):
    """A second, smaller estimate by an estimator of another family, which the first must agree with."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    estimator: Annotated[str, AfterValidator(_checker)] | None = Field(
        default=None,
        description="estimator that checks; default: the first of another family that can run the system; mc "
        "where failures are not rare",
    )
    share: float = Field(
        default=0.15, gt=0.0, le=1.0, description="cost of the check as a share of the estimate's own"
    )

    @property
    def versions(self) -> dict[str, str]:
        """Versions of the installed distributions that the checking estimator may come from."""
        registry = default_registry()
        checkers = registry.checkers()
        return registry.versions(each for each in checkers if self.estimator in (None, each.name))

    def find_conflict(self, estimator: str) -> str | None:
        """Return why this check is not allowed for ``estimator``, None if it is."""
        family = default_registry().family
        if self.estimator is None or family(self.estimator) != family(estimator):
            return None
        return f"{self.estimator} is of the same family as {estimator}"


def as_cross_check(value: object) -> object:
    """Return the default check for true, None for false, anything else as it is."""
    if isinstance(value, bool):
        return CrossCheck() if value else None
    return value
