"""Traffic lights of a file: set by actions, or switched by the phases of their controllers."""

import pytest

from avrare_openscenario.scenes_command import judge_scene, read_acted
from avrare_openscenario.trace import act_out
from openscenario_files import SCENARIOS, document, event, slow_down

PHASE = (
    '<Phase name="{name}" duration="{seconds}"><TrafficSignalState trafficSignalId="7" state="{state}"/>'
    "</Phase>"
)
PHASES = "".join(
    PHASE.format(name=name, seconds=seconds, state=state)
    for name, seconds, state in (("go", 2.0, "green"), ("stop", 3.0, "red"), ("go", 1.0, "green"))
)
CONTROLLERS = (
    f'<TrafficSignals><TrafficSignalController name="A" delay="0.5">{PHASES}</TrafficSignalController>'
    f'<TrafficSignalController name="B" delay="1.5" reference="A">{PHASES.replace("7", "8")}'
    "</TrafficSignalController></TrafficSignals></RoadNetwork>"
)
SHOWS = '<ByValueCondition><TrafficSignalCondition name="{}" state="{}"/></ByValueCondition>'
IN_PHASE = '<TrafficSignalControllerCondition trafficSignalControllerRef="A" phase="{}"/>'
LIGHT = (
    "<GlobalAction><InfrastructureAction><TrafficSignalAction>{}</TrafficSignalAction></InfrastructureAction>"
    "</GlobalAction>"
)
SET = LIGHT.format('<TrafficSignalStateAction name="{}" state="{}"/>')
SWITCH = LIGHT.format('<TrafficSignalControllerAction trafficSignalControllerRef="A" phase="{}"/>')
BRAKES = slow_down(shape="step", target=5.0)


@pytest.fixture
def read(tmp_path):
    def read(condition, *actions, lights=CONTROLLERS):
        (tmp_path / "motorway.xodr").write_bytes((SCENARIOS / "openscenario/motorway.xodr").read_bytes())
        before = [
            event(BRAKES, name=f"set {k}").replace(f"<PrivateAction>{BRAKES}</PrivateAction>", action)
            for k, action in enumerate(actions)
        ]
        text = document(*before, event(BRAKES, condition)).replace("</RoadNetwork>", lights)
        (tmp_path / "scene.xosc").write_text(text, encoding="utf-8")
        return str(tmp_path / "scene.xosc")

    return read


def find_begin(path):
    """Return when the car brakes [s]."""
    times, states = act_out(read_acted(path, 0.1), 0.1, 12.0)
    slow = states[:, 0, 3] < 20.0
    return round(times[slow.argmax()], 1) if slow.any() else None


@pytest.mark.parametrize(
    ("condition", "begins"),
    [
        (SHOWS.format(7, "red"), 2.5),
        (SHOWS.format(7, "green"), 0.0),  # the last phase ends at the delay
        (SHOWS.format(8, "green"), 1.0),  # a second before its delay of 0.5 + 1.5 s
        (SHOWS.format(8, "red"), 0.0),
        (SHOWS.format(7, "amber"), None),
        (SHOWS.format(9, "red"), None),
        (f"<ByValueCondition>{IN_PHASE.format('stop')}</ByValueCondition>", 2.5),
    ],
)
def test_phases_repeat_from_their_delay_on(read, condition, begins):
    path = read(condition)
    assert judge_scene(path).status == "read"
    found = find_begin(path)
    assert found == (None if begins is None else pytest.approx(begins + 0.1))


@pytest.mark.parametrize(
    ("condition", "action", "begins"),
    [
        (SHOWS.format(9, "red"), SET.format(9, "red"), 1.1),
        (SHOWS.format(7, "red"), SET.format(7, "green"), None),
        (SHOWS.format(7, "red"), SWITCH.format("stop"), 1.1),
        (SHOWS.format(7, "red"), SWITCH.format("go"), 3.0),  # whose phase begins anew at 1 s
    ],
)
def test_actions_set_a_light_or_a_phase(read, condition, action, begins):
    assert judge_scene(read(condition, action)).status == "read"
    found = find_begin(read(condition, action))
    assert found == (None if begins is None else pytest.approx(begins + 0.1))


@pytest.mark.parametrize(
    ("action", "lights", "message"),
    [
        (SWITCH.format("night"), CONTROLLERS, "TrafficSignalControllerAction: 'A' has no such phase"),
        (SWITCH.format("go"), "</RoadNetwork>", "'A' is not among the TrafficSignals"),
        (SET.format(7, "red"), CONTROLLERS.replace('0"><', '-9"><'), "phases should last longer than 0 s"),
    ],
)
def test_mistakes_are_named_at_their_line(read, action, lights, message):
    finding = judge_scene(read(SHOWS.format(7, "red"), action, lights=lights))
    assert finding.status == "refused"
    assert finding.line is not None
    assert message in finding.reason
