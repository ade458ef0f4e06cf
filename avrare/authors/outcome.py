"""A check of a component, and what came of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from avrare.errors import AvrareError

if TYPE_CHECKING:
    from avrare.authors.subject import Subject

Status = Literal["passed", "failed", "skipped"]


class Skipped(Exception):
    """A check that says nothing of this component; the message is the reason."""


@dataclass(frozen=True)
class Outcome:
    """One row of ``avrare check-plugin``.

    Attributes:
        kind: Of the component.
        component: Its name.
        check: Name of the check.
        sentence: What it asks for.
        status: How it went.
        reason: Why it failed or was skipped, one line; empty where it passed.
    """

    kind: str
    component: str
    check: str
    sentence: str
    status: Status
    reason: str = ""


@dataclass(frozen=True)
class Check:
    """A function that raises where a component does not keep to something.

    Attributes:
        function: Takes the subject; its docstring is one sentence.
    """

    function: Callable[[Subject], None]

    @property
    def name(self) -> str:
        """``rows_are_independent``."""
        return self.function.__name__

    @property
    def sentence(self) -> str:
        """What it asks for."""
        return " ".join((self.function.__doc__ or "").split())

    def run(self, subject: Subject) -> Outcome:
        """How it goes; whatever the component raises is an outcome too."""
        status, reason = self._verdict(subject)
        return Outcome(subject.kind, subject.name, self.name, self.sentence, status, reason)

    def _verdict(self, subject: Subject) -> tuple[Status, str]:
        try:
            self.function(subject)
        except Skipped as skipped:
            return "skipped", str(skipped)
        except AssertionError as error:
            return "failed", _line(error) or "it does not hold"
        except AvrareError as error:
            return "failed", " ".join(error.lines())
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # SystemExit, and what pytest.raises ends with, are no Exception
            return "failed", f"{type(error).__name__}: {_line(error)}"
        return "passed", ""


def _line(error: BaseException) -> str:
    """The first paragraph of a message on one line: NumPy's and pytest's go on for pages."""
    return " ".join(str(error).strip().split("\n\n")[0].split())[:300]
