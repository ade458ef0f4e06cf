"""Entries of OpenSCENARIO catalogs, with their parameters put in."""

from __future__ import annotations

import glob
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from avrare.base.errors import did_you_mean
from avrare_openscenario.parameters import REFERENCE, Parameters
from avrare_openscenario.xml_tree import Element, read_xml

_KINDS = ("Vehicle", "Pedestrian", "MiscObject", "Maneuver", "Trajectory", "Route")
"""Catalogs whose locations are looked into."""


class Catalogs:
    """Catalogs that a scenario may refer to.

    Args:
        locations: The element ``CatalogLocations``, if there is one.
        parameters: Parameters of the scenario.
        given: Catalog files to use instead of those in its folders; empty: those.
        allowed: Raises an error where a file (path, what it is) may not be read.

    Attributes:
        used: Files of the catalogs that were referred to.
    """

    def __init__(
        self,
        locations: Element | None,
        parameters: Parameters,
        given: Sequence[str] = (),
        allowed: Callable[[str, str], None] | None = None,
    ) -> None:
        self.parameters, self.allowed = parameters, allowed
        self.used: list[str] = []
        self._entries: list[Element] = []
        self._read: dict[str, Element] | None = None
        self._copied = 0
        folders: list[Element] = []
        if locations is not None:
            folders = [folder for kind in _KINDS for folder in locations.list(f"{kind}Catalog")]
            locations.skip()
        paths = [parameters.path(folder.child("Directory"), "path") for folder in folders]
        self._folders = list(dict.fromkeys(map(os.path.normpath, paths)))
        self._given = list(given)

    def find(self, holder: Element, tag: str) -> Element:
        """Return the only child with this name, or the entry that the holder refers to instead."""
        reference = holder.find("CatalogReference")
        return holder.child(tag) if reference is None else self.resolve(reference, (tag,))

    def resolve(self, reference: Element, kinds: Sequence[str]) -> Element:
        """Return the entry that an element ``CatalogReference`` names, which must be one of these kinds.

        Raises:
            UsageError: The entry does not exist, or its parameters are not those that are assigned.
        """
        top = self._find(reference)
        children = top.child("Catalog").children
        name = self.parameters.text(reference, "entryName")
        entries = [child for child in children if child.get("name") == name]
        if not entries:
            hint = did_you_mean(name, [child.get("name") or "" for child in children])
            raise reference.error(f"there is no entry {name!r} in {top.path}", hint)
        if len(entries) > 1:
            raise entries[1].error(f"a second entry {name!r}", "give it another name")
        source = entries[0]
        if source.tag not in kinds:
            raise reference.error(f"the entry {name!r} is a {source.tag}", f"known here: {', '.join(kinds)}")
        values = _values(source, reference)
        entry = self._copy(source, values)
        entry.skip_children("ParameterDeclarations")
        self._entries.append(entry)
        return entry

    def refuse_unread(self) -> None:
        """Raise an error at the first part of an entry that was not asked for."""
        for entry in self._entries:
            entry.refuse_unread()

    def notes(self) -> tuple[str, ...]:
        """Return the notes on the entries, each with its place."""
        return tuple(note for entry in self._entries for note in entry.notes())

    def _find(self, reference: Element) -> Element:
        if self._read is None:
            self._read = self._read_all()
        name = self.parameters.text(reference, "catalogName")
        files = {os.path.splitext(os.path.basename(file.path))[0]: file for file in self._read.values()}
        top = self._read.get(name) or files.get(name)  # players look for the file of that name
        if top is None:
            names = ", ".join(self._read) or "none"
            paths = [folder for folder in self._folders if not os.path.isdir(folder)]
            missing = "".join(f"; {path} is not a folder" for path in paths)
            hint = f"found in the folders of CatalogLocations: {names}{missing}"
            raise reference.error(f"there is no catalog {name!r}", hint)
        if top.path not in self.used:
            self.used.append(top.path)
        return top

    def _read_all(self) -> dict[str, Element]:
        catalogs: dict[str, Element] = {}
        for path in self._given or self._list_files():
            if self.allowed is not None:
                self.allowed(path, "CatalogLocations")
            top = read_xml(path, "OpenSCENARIO")
            catalog = top.find("Catalog")
            if catalog is None:  # a scenario that lies beside
                continue
            name = catalog.attribute("name")
            if name in catalogs:
                raise catalog.error(f"there are two catalogs {name!r}", f"the other is {catalogs[name].path}")
            catalogs[name] = top
        return catalogs

    def _list_files(self) -> list[str]:
        paths = []
        for folder in self._folders:
            if self.allowed is not None:
                self.allowed(folder, "CatalogLocations")
            files = sorted(glob.glob(os.path.join(glob.escape(folder), "*")))
            suffix = ".xosc"
            paths += [file for file in files if file.lower().endswith(suffix)]
        return paths

    def _copy(self, element: Element, values: Mapping[str, str]) -> Element:
        self._copied += 1
        most = 100_000  # most elements that entries put into a scenario
        if self._copied > most:
            raise element.error(f"more than {most:,} elements of catalogs are used")
        return replace(
            element,
            attributes={name: _put_in(element, text, values) for name, text in element.attributes.items()},
            children=[self._copy(child, values) for child in element.children],
            _asked=set(),
        )


def _values(entry: Element, reference: Element) -> dict[str, str]:
    # Values of the entry's own parameters; those that are assigned may refer to the scenario's.
    block = entry.find("ParameterDeclarations")
    values = {}
    for declaration in block.list("ParameterDeclaration") if block is not None else ():
        declaration.get("parameterType")
        values[declaration.attribute("name")] = declaration.attribute("value")
        declaration.skip_children("ConstraintGroup")
    if block is not None:
        block.refuse_unread()
    assigned_names: set[str] = set()
    assigned = reference.find("ParameterAssignments")
    for assignment in assigned.list("ParameterAssignment") if assigned is not None else ():
        name = assignment.attribute("parameterRef").removeprefix("$")
        if name not in values:
            hint = did_you_mean(name, values)
            raise assignment.error(f"the entry {entry.get('name')!r} has no parameter {name!r}", hint)
        values[name] = assignment.attribute("value")
        assigned_names.add(name)
    for name, text in values.items():  # a value may refer to those before it; one assigned, to the scenario's
        if name not in assigned_names:
            values[name] = _put_in(entry, text, values)
    return values


def _put_in(element: Element, text: str, values: Mapping[str, str]) -> str:
    names = REFERENCE.findall(text)
    for name in names:
        if name not in values:
            hint = did_you_mean(name, values)
            raise element.error(f"no parameter {name!r} is declared in this entry", hint)
    if names == [text[1:]]:
        return values[names[0]]
    return REFERENCE.sub(lambda match: f"({_bare(values[match[1]])})", text)


def _bare(value: str) -> str:
    # An expression within another has no braces of its own.
    return value[2:-1] if value.startswith("${") and value.endswith("}") else value
