"""Traffic lights: what they show in each phase of their controllers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from avrare_openscenario.parameters import Parameters
from avrare_openscenario.xml_tree import Element

UNSET = -1e9
"""Value of a traffic light that its controller switches."""


@dataclass(frozen=True)
class Controller:
    """Controller of traffic lights.

    Attributes:
        name: Its name.
        delay: When its first phase begins [s].
        phases: Begin and end in the cycle of each phase [s], and the state of each light by its id; that of
            the id ``""`` is the name of the phase.
    """

    name: str
    delay: float
    phases: tuple[tuple[float, float, Mapping[str, str]], ...]

    def list_spans(self, light: str, state: str) -> list[tuple[float, float]]:
        """Return when in the cycle a light shows a state."""
        return [(begin, end) for begin, end, shown in self.phases if shown.get(light) == state]


def read_controllers(lights: Element | None, parameters: Parameters) -> list[Controller]:
    """Return the controllers of the element ``TrafficSignals``."""
    controllers: list[Controller] = []
    for element in lights.list("TrafficSignalController") if lights is not None else ():
        delay = 0.0 if element.get("delay") is None else parameters.fixed(element, "delay")
        reference = element.get("reference")
        delay += sum(other.delay for other in controllers if other.name == reference)
        phases, begin = list[tuple[float, float, Mapping[str, str]]](), 0.0
        for phase in element.list("Phase"):
            end, shown = begin + parameters.fixed(phase, "duration"), {"": parameters.text(phase, "name")}
            phase.skip_children("TrafficSignalGroupState")
            for state in phase.list("TrafficSignalState"):
                shown[parameters.text(state, "trafficSignalId")] = parameters.text(state, "state")
            phases.append((begin, end, shown))
            begin = end
        if begin <= 0.0:
            raise element.error("its phases should last longer than 0 s")
        controllers.append(Controller(parameters.text(element, "name"), delay, tuple(phases)))
    return controllers
