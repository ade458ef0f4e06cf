"""Traffic lights: what actions set them to, or what they show in the phases of their controllers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from avrare.base.errors import did_you_mean
from avrare_openscenario.parameters import Number, Parameters
from avrare_openscenario.story import Assignment, Condition
from avrare_openscenario.xml_tree import Element

UNSET = -1e9
"""Value of a traffic light that its controller switches."""


@dataclass(frozen=True)
class _Controller:
    # Phases repeat: begin, end, and what each light shows; of the light "" the name of the phase.
    name: str
    delay: float
    phases: tuple[tuple[float, float, Mapping[str, str]], ...]

    def list_spans(self, light: str, state: str) -> list[tuple[float, float]]:
        return [(begin, end) for begin, end, shown in self.phases if shown.get(light) == state]


class Signals:
    """Traffic lights of one file; their states are added to its variables."""

    def __init__(self, lights: Element | None, parameters: Parameters, variables: dict[str, Number]) -> None:
        self.parameters, self.variables = parameters, variables
        self._controllers: dict[str, _Controller] = {}
        for element in lights.list("TrafficSignalController") if lights is not None else ():
            controller = self._read_controller(element)
            self._controllers[controller.name] = controller

    def read_action(self, holder: Element) -> Assignment:
        """Read a ``TrafficSignalAction``."""
        action = holder.choice("TrafficSignalStateAction", "TrafficSignalControllerAction")
        if action.tag == "TrafficSignalStateAction":
            light = self._find("light", self.parameters.text(action, "name"), UNSET)
            return Assignment(light, self.parameters.value(action, "state"), "set")
        action.skip_children("Phase")
        controller = self._find_controller(action)
        spans = controller.list_spans("", self.parameters.text(action, "phase"))
        if not spans:
            raise action.error(f"{controller.name!r} has no such phase")
        return Assignment(self._find_clock(controller), self.parameters.constant(spans[0][0]), "start")

    def read_condition(self, condition: Element) -> Condition:
        """Read a condition on what a light shows, or on the phase of a controller."""
        if condition.tag == "TrafficSignalControllerCondition":
            light, name, controllers = "", "phase", [self._find_controller(condition)]
        else:
            light, name, every = self.parameters.text(condition, "name"), "state", self._controllers.values()
            controllers = [each for each in every if any(light in shown for *_, shown in each.phases)]
        variable, value = self._find("light", light, UNSET), self.parameters.value(condition, name)
        if not controllers:
            return Condition("variable", "equalTo", value, variable=variable)
        spans = controllers[0].list_spans(light, self.parameters.text(condition, name))
        times = (controllers[0].phases[-1][1], *(time for span in spans for time in span))
        reach, clock = tuple(map(self.parameters.constant, times)), self._find_clock(controllers[0])
        return Condition("light", "equalTo", value, variable=variable, other=clock, reach=reach)

    def _find(self, kind: str, name: str, value: float) -> int:
        # Index of a variable, whose name no variable of the file has.
        name = f"{kind} {name}"
        if name not in self.variables:
            self.variables[name] = self.parameters.constant(value)
        return list(self.variables).index(name)

    def _find_clock(self, controller: _Controller) -> int:
        return self._find("controller", controller.name, -controller.delay)

    def _find_controller(self, element: Element) -> _Controller:
        name = self.parameters.text(element, "trafficSignalControllerRef")
        if name not in self._controllers:
            hint = did_you_mean(name, self._controllers)
            raise element.error(f"{name!r} is not among the TrafficSignals", hint)
        return self._controllers[name]

    def _read_controller(self, element: Element) -> _Controller:
        text, read_number = self.parameters.text, self.parameters.read_number
        delay = 0.0 if element.get("delay") is None else read_number(element, "delay")
        if (reference := element.get("reference")) in self._controllers:
            delay += self._controllers[reference].delay
        phases, begin = list[tuple[float, float, Mapping[str, str]]](), 0.0
        for phase in element.list("Phase"):
            end, shown = begin + read_number(phase, "duration"), {"": text(phase, "name")}
            phase.skip_children("TrafficSignalGroupState")
            for state in phase.list("TrafficSignalState"):
                shown[text(state, "trafficSignalId")] = text(state, "state")
            phases.append((begin, end, shown))
            begin = end
        if begin <= 0.0:
            raise element.error("its phases should last longer than 0 s")
        return _Controller(text(element, "name"), delay, tuple(phases))
