"""Elements of an XML file with their places, and a record of which of them were understood.

A reader asks for what it knows; at the end ``refuse_unread`` names the first element or attribute that nobody
asked for, so that nothing of a file is passed over in silence. The file may come from a stranger: its size,
its depth and its declarations are bounded.
"""

from __future__ import annotations

import math
import xml.parsers.expat
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from avrare.base.errors import UsageError

MOST_BYTES = 16 * 1024 * 1024
"""Largest file that is read."""


@dataclass
class Element:
    """Element of a file.

    Attributes:
        tag: Its name.
        path: The file.
        line: Where it begins, from 1.
        column: The same.
        attributes: Its attributes as written.
        children: The elements in it.
    """

    tag: str
    path: str
    line: int
    column: int
    attributes: dict[str, str]
    children: list[Element] = field(default_factory=list)
    _asked: set[str] = field(default_factory=set)
    _known: bool = False
    _note: str = ""

    def error(self, text: str, hint: str | None = None) -> UsageError:
        """Return the error with this message about the element."""
        return UsageError(f"{self.path}:{self.line}:{self.column}: {self.tag}: {text}", hint)

    def find(self, tag: str) -> Element | None:
        """Return the only child with this name, or None."""
        children = self.list(tag)
        if len(children) > 1:
            raise children[1].error(f"a second {tag} in {self.tag}")
        return children[0] if children else None

    def child(self, tag: str) -> Element:
        """Return the only child with this name."""
        child = self.find(tag)
        if child is None:
            raise self.error(f"lacks the element {tag}")
        return child

    def list(self, tag: str) -> list[Element]:
        """Return all children with this name."""
        children = [child for child in self.children if child.tag == tag]
        for child in children:
            child._known = True
        return children

    def choice(self, *tags: str) -> Element:
        """Return the first child; if names are given, it must have one of them."""
        if not self.children:
            raise self.error("is empty")
        child = self.children[0]
        child._known = True
        if tags and child.tag not in tags:
            raise child.error("is not read", f"known here: {', '.join(tags)}")
        return child

    def get(self, name: str) -> str | None:
        """Return an attribute, or None."""
        self._asked.add(name)
        return self.attributes.get(name)

    def ignore(self, *names: str) -> None:
        """Count attributes as understood: they change nothing."""
        self._asked.update(names)

    def attribute(self, name: str) -> str:
        """Return an attribute that must be there."""
        value = self.get(name)
        if value is None:
            raise self.error(f"lacks the attribute {name}")
        return value

    def number(self, name: str) -> float:
        """Return an attribute that must be a finite number."""
        text = self.attribute(name)
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise self.error(f"{name} should be a number, found {text[:40]!r}")
        return value

    def skip(self) -> None:
        """Count the element and all within it as understood: it changes nothing."""
        for element in self.walk():
            element._known = True
            element._asked.update(element.attributes)

    def skip_children(self, *tags: str) -> None:
        """Skip the children with these names."""
        for tag in tags:
            for child in self.list(tag):
                child.skip()

    def skip_everywhere(self, *tags: str) -> None:
        """Skip the elements with these names at any depth."""
        for element in self.walk():
            element.skip_children(*tags)

    def list_names(self, within: str, attribute: str) -> set[str]:
        """Return what the children of all elements with a name have as an attribute."""
        children = (child for element in self.walk() if element.tag == within for child in element.children)
        return {name for child in children if (name := child.attributes.get(attribute)) is not None}

    def pass_over(self, note: str) -> None:
        """Skip the element, and note what is left out by it."""
        self.skip()
        self._note = note

    def note(self, text: str) -> None:
        """Note how the element is read where a file may mean more."""
        self._note = text

    def notes(self) -> tuple[str, ...]:
        """Return the notes on it and all within it, each with its place."""
        noted = (element for element in self.walk() if element._note)
        return tuple(f"{element.path}:{element.line}: {element.tag}: {element._note}" for element in noted)

    def refuse_unread(self) -> None:
        """Raise an error at the first element or attribute in it that was not asked for.

        Elements without attributes and children say nothing.
        """
        for element in self.walk():
            for child in element.children:
                if not child._known and (child.children or child.attributes):
                    hint = "see docs/openscenario.md for what is; or take it out"
                    raise child.error(f"is not read in {element.tag}", hint)
            if unread := sorted(set(element.attributes) - element._asked):
                raise element.error(f"the attribute {unread[0]} is not read", "see docs/openscenario.md")

    def walk(self) -> Iterator[Element]:
        """Return the element and all within it."""
        yield self
        for child in self.children:
            yield from child.walk()


def read_xml(path: str, root: str) -> Element:
    """Read a file whose top element is ``root``.

    Raises:
        UsageError: It cannot be read, is no XML, too large or too deep, or declares types or entities.
    """
    try:
        with Path(path).open("rb") as file:
            content = file.read(MOST_BYTES + 1)
    except (OSError, ValueError) as error:
        reason = "no such file" if isinstance(error, FileNotFoundError) else str(error)
        raise UsageError(f"{path}: {reason}") from None
    if len(content) > MOST_BYTES:
        raise UsageError(f"{path}: larger than {MOST_BYTES // 2**20} MiB", "is this the right file?")
    top = _Builder(path).parse(content)
    if top.tag != root:
        raise top.error(f"the file should begin with {root}", "is this the right file?")
    return top


class _Builder:
    def __init__(self, path: str) -> None:
        self.path = path
        self.open: list[Element] = []
        self.top: Element | None = None
        self.parser = parser = xml.parsers.expat.ParserCreate()
        parser.StartElementHandler = self._start
        parser.EndElementHandler = self._end
        parser.StartDoctypeDeclHandler = self._refuse_doctype

    def parse(self, content: bytes) -> Element:
        try:
            self.parser.Parse(content, True)
        except (xml.parsers.expat.ExpatError, UnicodeError, LookupError, ValueError) as error:
            expat = xml.parsers.expat
            reason = expat.ErrorString(error.code) if isinstance(error, expat.ExpatError) else str(error)
            raise UsageError(f"{self._here()}: no XML: {reason}") from None
        assert self.top is not None  # an empty file is an error of the parser
        return self.top

    def _here(self) -> str:
        return f"{self.path}:{self.parser.CurrentLineNumber}:{self.parser.CurrentColumnNumber + 1}"

    def _refuse_doctype(self, *_: object) -> None:
        raise UsageError(f"{self._here()}: a document type is declared", "take out the line <!DOCTYPE ...>")

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        deepest = 64  # elements within each other
        if len(self.open) >= deepest:
            raise UsageError(f"{self._here()}: more than {deepest} elements within each other")
        written = {name: text for name, text in attributes.items() if ":" not in name and name != "xmlns"}
        place = self.parser.CurrentLineNumber, self.parser.CurrentColumnNumber + 1
        element = Element(tag.rpartition(":")[2], self.path, *place, written)
        if self.open:
            self.open[-1].children.append(element)
        else:
            self.top = element
        self.open.append(element)

    def _end(self, _: str) -> None:
        self.open.pop()
