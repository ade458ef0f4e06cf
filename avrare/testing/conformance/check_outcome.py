"""A conformance check and its outcome."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

from avrare.base.errors import AvrareError

Status = Literal["passed", "failed", "skipped"]


class Skipped(Exception):
    """Raised where a check does not apply to a component; the message is the reason."""


@dataclass(frozen=True)
class Outcome:
    """One row of ``avrare check-plugin``.

    Attributes:
        kind: Kind of the component.
        component: Name of the component.
        check: Name of the check.
        sentence: Requirement of the check.
        status: Whether it passed.
        reason: Reason why it failed or was skipped, one line; empty where it passed.
    """

    kind: str
    component: str
    check: str
    sentence: str
    status: Status
    reason: str = ""


@dataclass(frozen=True)
class Check:
    """A function that raises where a component does not meet a requirement.

    Attributes:
        function: Function of a ``Subject``; its docstring is the requirement in one sentence.
    """

    function: Callable[[Any], None]

    @property
    def name(self) -> str:
        """Name of the check, for example ``rows_are_independent``."""
        return self.function.__name__

    @property
    def sentence(self) -> str:
        """Requirement of the check."""
        return " ".join((self.function.__doc__ or "").split())

    def run(self, subject: Any) -> Outcome:
        """Run the check; whatever the component raises becomes an outcome."""
        status, reason = self._verdict(subject)
        return Outcome(subject.kind, subject.name, self.name, self.sentence, status, reason)

    def _verdict(self, subject: Any) -> tuple[Status, str]:
        try:
            self.function(subject)
        except Skipped as skipped:
            return "skipped", str(skipped)
        except AssertionError as error:
            return "failed", _first_paragraph(error) or "the check does not hold"
        except AvrareError as error:
            return "failed", " ".join(error.lines())
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # SystemExit and the failure of pytest.raises are not Exceptions
            return "failed", f"{type(error).__name__}: {_first_paragraph(error)}"
        return "passed", ""


def _first_paragraph(error: BaseException) -> str:
    # on one line: messages of NumPy and pytest fill pages
    return " ".join(str(error).strip().split("\n\n")[0].split())[:300]
