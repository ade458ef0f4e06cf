"""Reading of a storyboard: acts, maneuvers and events."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Literal

from avrare_openscenario.action_reader import ActionReader
from avrare_openscenario.condition_reader import ConditionReader
from avrare_openscenario.story import (
    Action,
    Assignment,
    Condition,
    Event,
    Group,
    Route,
    Starts,
    Storyboard,
    Trigger,
)
from avrare_openscenario.xml_tree import Element

_STATES = ("standbyState", "runningState", "completeState", "startTransition", "endTransition")
_EGO_DRIVEN = (
    "the ego is driven by the controller under test, not by the storyboard",
    "take it out, or set `ignore_ego_events: true`",
)


@dataclass(frozen=True)
class _Named:
    # Element of the storyboard that a condition may refer to.
    kind: str
    path: tuple[str, ...]
    events: tuple[int, ...]
    begin: Literal["event", "act", "story"] = "event"
    act: int = -1
    actions: tuple[int, ...] = ()  # those of one action among several of an event


class StoryReader:
    """Reader of one file's storyboard: ``ego`` is the index of the entity that a stack drives."""

    def __init__(self, reading: ActionReader, dt: float, ego: int | None, ignore_ego: bool) -> None:
        self.reading, self.parameters = reading, reading.parameters
        self.ego, self.ignore_ego = ego, ignore_ego
        self.asking = ConditionReader(reading, dt)
        self.actions: list[Action] = []
        self.events: list[Event] = []
        self.conditions: list[Condition] = []
        self.acts: list[Trigger] = []
        self.stops: list[Trigger | None] = []
        self.groups: list[Group] = []
        self.maneuvers = 0
        self.selects = False  # whether who meets a trigger acts
        self.elements: list[_Named] = []
        self._path: list[str] = []
        self._waiting: list[tuple[int, Element]] = []

    def read(self, board: Element, starts: Starts) -> Storyboard:
        """Read the element ``Storyboard`` after its ``Init``."""
        board.skip_children("StopTrigger")  # the scenario's ``steps`` end a rollout
        actions = [
            action for action in starts.actions if isinstance(action, Assignment) or action.actor != self.ego
        ]
        if len(actions) < len(starts.actions) and not self.ignore_ego:
            raise board.error(*_EGO_DRIVEN)
        if actions:
            self.acts.append(())
            self.stops.append(None)
            self.actions += actions
            self.events.append(Event("Init", 0, -1, (), tuple(range(len(self.actions))), False))
        for story in board.list("Story"):
            declarations = story.find("ParameterDeclarations")
            with self.parameters.scope(declarations), self._record_element(story, "story"):
                for act in story.list("Act"):
                    self._read_act(act)
        for index, element in self._waiting:
            self._resolve_state(index, element)
        return Storyboard(
            **{**vars(starts), "actions": tuple(self.actions)},
            acts=tuple(self.acts),
            stops=tuple(self.stops),
            events=tuple(self.events),
            conditions=tuple(self.conditions),
            variables=tuple(self.reading.variables.values()),
            groups=tuple(self.groups),
        )

    @contextmanager
    def _record_element(self, element: Element, kind: str, act: int = -1) -> Iterator[None]:
        # What is read within belongs to the element.
        first = len(self.events)
        self._path.append(element.get("name") or "")
        yield
        events = tuple(range(first, len(self.events)))
        begin: Literal["event", "act", "story"] = "act" if act >= 0 else "event"
        begin = "story" if kind == "story" else begin
        self.elements.append(_Named(kind, tuple(self._path), events, begin, act))
        self._path.pop()

    def _read_act(self, act: Element) -> None:
        index = len(self.acts)
        start, stop = act.find("StartTrigger"), act.find("StopTrigger")
        self.acts.append(() if start is None else self._read_trigger(start))
        self.stops.append(self._read_trigger(stop) if stop is not None and stop.children else None)
        with self._record_element(act, "act", index):
            for group in act.list("ManeuverGroup"):
                with self._record_element(group, "maneuverGroup", index):
                    self._read_group(group, index)

    def _read_group(self, group: Element, act: int) -> None:
        group.get("name")
        count, first = self._count(group), len(self.events)
        actors = group.child("Actors")
        self.selects = self.parameters.boolean(actors, "selectTriggeringEntities")
        chosen = list(self.reading.find_entities(actors))
        references = group.list("CatalogReference")
        referred = [self.reading.catalogs.resolve(reference, ("Maneuver",)) for reference in references]
        for maneuver in [*referred, *group.list("Maneuver")]:
            declarations = None if maneuver in referred else maneuver.find("ParameterDeclarations")
            with self.parameters.scope(declarations), self._record_element(maneuver, "maneuver", act):
                self._read_maneuver(maneuver, act, chosen)
        if count > 1:
            self.groups.append(Group(count, tuple(range(first, len(self.events)))))

    def _read_maneuver(self, maneuver: Element, act: int, actors: list[int]) -> None:
        if self.ego in actors:
            if not self.ignore_ego:
                raise maneuver.error(*_EGO_DRIVEN)
            actors = [actor for actor in actors if actor != self.ego]
        for event in maneuver.list("Event"):
            with self._record_element(event, "event"):
                if self.selects:
                    for actor in self._find_triggering(event):
                        self._read_event(event, act, [actor])
                else:
                    self._read_event(event, act, actors)
        self.maneuvers += 1

    def _read_event(self, event: Element, act: int, actors: list[int]) -> None:
        priorities = ("override", "overwrite", "parallel", "skip")
        priority = self.parameters.choose(event, "priority", priorities, "parallel")
        first, number = len(self.actions), len(self.events)
        elements = event.list("Action")
        for element in elements:
            path, before = (*self._path, element.get("name") or ""), len(self.actions)
            self.actions += self._read_action(element, actors)
            several = tuple(range(before, len(self.actions))) if len(elements) > 1 else ()
            self.elements.append(_Named("action", path, (number,), actions=several))
        start = event.find("StartTrigger")
        chosen = actors[0] if self.selects else None
        trigger = () if start is None else self._read_trigger(start, chosen)
        actions = tuple(range(first, len(self.actions)))
        name, overrides = event.attribute("name"), priority in ("override", "overwrite")
        how = overrides, self._count(event), priority == "skip"
        self.events.append(Event(name, act, self.maneuvers, trigger, actions, *how))

    def _find_triggering(self, event: Element) -> list[int]:
        # Entities that may meet the trigger of an event, or of its act where it has none.
        named = event.list_names("TriggeringEntities", "entityRef")
        if not named:
            raise event.error("selectTriggeringEntities needs a trigger of the event that names entities")
        return [index for index, name in enumerate(self.reading.names) if name in named and index != self.ego]

    def _count(self, event: Element) -> int:
        # How often an event or a maneuver group may begin.
        if event.get("maximumExecutionCount") in (None, "0"):
            return 1
        count = self.parameters.read_integer(event, "maximumExecutionCount")
        most = 1_000_000_000
        if not 1 <= count <= most:
            raise event.error("maximumExecutionCount should be at least 1")
        return count

    def _read_action(self, element: Element, actors: Sequence[int]) -> list[Action]:
        if not element.children:
            element.note("an action without content does nothing")
            return []
        kind = element.choice()
        if kind.tag == "PrivateAction":
            if not actors:
                element.skip()
            actions = [self.reading.read_private(kind, actor) for actor in actors]
            if self.ego is not None and any(isinstance(action, Route) for action in actions):
                raise kind.error("a route is not read under a stack", "see docs/openscenario.md")
        else:
            actions = [self.reading.read_global(kind)]
        return [action for action in actions if action is not None]

    def _read_trigger(self, trigger: Element, chosen: int | None = None) -> Trigger:
        groups = []
        for group in trigger.list("ConditionGroup"):
            first = len(self.conditions)
            for condition in group.list("Condition"):
                asked = self.asking.read(condition)
                if asked.kind == "state":
                    self._waiting.append((len(self.conditions), condition.choice().choice()))
                if chosen is not None and chosen in asked.entities:
                    asked = replace(asked, entities=(chosen,))
                self.conditions.append(asked)
            if len(self.conditions) == first:
                raise group.error("has no condition")
            groups.append(tuple(range(first, len(self.conditions))))
        if not groups:
            trigger.note("a trigger without conditions is met at once")
        return tuple(groups)

    def _resolve_state(self, index: int, element: Element) -> None:
        kind, name = (self.parameters.text(element, f"storyboardElement{end}") for end in ("Type", "Ref"))
        state = self.parameters.choose(element, "state", _STATES)
        parts = tuple(re.split("::|/", name))
        matches = [each for each in self.elements if (each.kind, each.path[-len(parts) :]) == (kind, parts)]
        if not matches:
            raise element.error(f"there is no {kind} {name!r}")
        if len(matches) > 1:
            text = f"there are {len(matches)} elements {kind} {name!r}"
            raise element.error(text, f"say which one: {'::'.join(matches[0].path)}")
        events = matches[0].events
        if matches[0].actions:  # an event of its own, which begins with the whole one
            whole = self.events[events[0]]
            single = replace(whole, maneuver=-2, actions=matches[0].actions, overrides=False, whole=events[0])
            events = (len(self.events),)
            self.events.append(single)
        self.conditions[index] = replace(
            self.conditions[index], events=events, state=state, begin=matches[0].begin, act=matches[0].act
        )
