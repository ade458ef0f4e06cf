"""OpenSCENARIO files in parts, and drives of them."""

from pathlib import Path

import numpy as np

from avrare.driving import Action

SCENARIOS = Path(__file__).parents[2] / "scenarios"


CAR = """<Vehicle name="car" vehicleCategory="car"><BoundingBox><Center x="{ahead}" y="0" z="0"/>
<Dimensions width="1.8" length="4.5" height="1.5"/></BoundingBox></Vehicle>"""


LATERAL = (
    '<LateralAction><LaneChangeAction{offset}><LaneChangeActionDynamics dynamicsShape="{shape}" '
    'dynamicsDimension="{dimension}" value="{value}"/><LaneChangeTarget>{target}</LaneChangeTarget>'
    "</LaneChangeAction></LateralAction>"
)


SPEED = (
    '<LongitudinalAction><SpeedAction><SpeedActionDynamics dynamicsShape="{shape}" '
    'dynamicsDimension="{dimension}" value="{value}"/><SpeedActionTarget>{target}</SpeedActionTarget>'
    "</SpeedAction></LongitudinalAction>"
)


AT_ONE = '<ByValueCondition><SimulationTimeCondition value="1.0" rule="greaterOrEqual"/></ByValueCondition>'


STEP = '<SpeedActionDynamics dynamicsShape="step" dynamicsDimension="time" value="0"/>'


HEADWAY = '<TimeHeadwayCondition entityRef="Ego" freespace="false" value="1.5" rule="greaterThan"/>'


GAP = (
    '<RelativeDistanceCondition entityRef="Ego" relativeDistanceType="longitudinal" freespace="true" '
    'value="20.0" rule="greaterOrEqual"/>'
)


APART = (
    '<RelativeDistanceCondition entityRef="Car" relativeDistanceType="cartesianDistance" '
    'freespace="false" value="25.0" rule="greaterOrEqual"/>'
)


REACH = (
    '<ReachPositionCondition tolerance="3.5"><Position><LanePosition roadId="1" laneId="-3" s="60" '
    'offset="0"/></Position></ReachPositionCondition>'
)


FASTER = '<RelativeSpeedCondition entityRef="Ego" value="2.0" rule="greaterThan"/>'


COLLISION = (
    '<TimeToCollisionCondition freespace="false" value="3.0" rule="lessOrEqual">'
    '<TimeToCollisionConditionTarget><EntityRef entityRef="Ego"/>'
    "</TimeToCollisionConditionTarget></TimeToCollisionCondition>"
)


LANE = '<AbsoluteTargetLane value="-2"/>'


def slow_down(shape="linear", dimension="rate", value=4.0, target=10.0):
    speed = f'<AbsoluteTargetSpeed value="{target}"/>'
    return SPEED.format(shape=shape, dimension=dimension, value=value, target=speed)


def change_lane(shape="cubic", dimension="time", value=2.0, target=None, offset=""):
    target = target or LANE
    return LATERAL.format(shape=shape, dimension=dimension, value=value, target=target, offset=offset)


def of_entity(condition, entity="Car"):
    return (
        '<ByEntityCondition><TriggeringEntities triggeringEntitiesRule="any">'
        f'<EntityRef entityRef="{entity}"/>'
        f"</TriggeringEntities><EntityCondition>{condition}</EntityCondition></ByEntityCondition>"
    )


def event(action, condition=AT_ONE, name="first", edge="none", delay="0", priority="parallel"):
    return (
        f'<Event name="{name}" priority="{priority}"><Action name="act of {name}"><PrivateAction>{action}'
        f"</PrivateAction></Action><StartTrigger><ConditionGroup><Condition name='c' delay='{delay}' "
        f"conditionEdge='{edge}'>{condition}</Condition></ConditionGroup></StartTrigger></Event>"
    )


def init(name, position, speed):
    return (
        f'<Private entityRef="{name}"><PrivateAction><TeleportAction><Position>{position}</Position>'
        f"</TeleportAction></PrivateAction><PrivateAction><LongitudinalAction><SpeedAction>{STEP}<SpeedActionTarget>"
        f'<AbsoluteTargetSpeed value="{speed}"/></SpeedActionTarget></SpeedAction></LongitudinalAction>'
        "</PrivateAction></Private>"
    )


def lane_position(s, lane=-3, offset=0):
    return f'<LanePosition roadId="1" laneId="{lane}" s="{s}" offset="{offset}"/>'


def document(*events, car=None, ego=None, speed=20.0, ahead=0.0, actor="Car"):
    """Return text of a scenario: the ego at 20 m/s in lane -2, a car in lane -3."""
    body = "".join(
        f'<ScenarioObject name="{name}">{CAR.format(ahead=ahead)}</ScenarioObject>' for name in ("Car", "Ego")
    )
    return f"""<OpenSCENARIO><FileHeader revMajor="1" revMinor="2" date="" description="" author=""/>
<ParameterDeclarations><ParameterDeclaration name="v" parameterType="double" value="{speed}"/>
<ParameterDeclaration name="lane" parameterType="integer" value="-2"/></ParameterDeclarations>
<RoadNetwork><LogicFile filepath="motorway.xodr"/></RoadNetwork><Entities>{body}</Entities>
<Storyboard><Init><Actions>
{init("Ego", ego or lane_position(10, -2), 20.0)}{init("Car", car or lane_position(30), "$v")}
</Actions></Init><Story name="s"><Act name="a"><ManeuverGroup name="g" maximumExecutionCount="1">
<Actors selectTriggeringEntities="false"><EntityRef entityRef="{actor}"/></Actors><Maneuver name="m">
{"".join(events)}
</Maneuver></ManeuverGroup></Act></Story><StopTrigger/></Storyboard></OpenSCENARIO>"""


def drive(simulator, seconds, n=1, values=None):
    """Return states (T, N, ...) of the others, the ego going straight on."""
    world = simulator.reset_drawn(np.zeros((n, 0)), values or {})
    found = [world.others]
    for _ in range(round(seconds / simulator.dt)):
        world = simulator.step(world, Action(np.zeros(n), np.zeros(n)), np.zeros((n, 0)))
        assert not simulator.faults(world).any()
        found.append(world.others)
    return {name: np.stack([getattr(one, name) for one in found]) for name in vars(found[0])}


def state_of(kind, name, state):
    return (
        f'<ByValueCondition><StoryboardElementStateCondition storyboardElementType="{kind}" '
        f'storyboardElementRef="{name}" state="{state}"/></ByValueCondition>'
    )


ACTION = f"<PrivateAction>{slow_down()}</PrivateAction>"


EUCLIDEAN = COLLISION.replace("freespace", 'relativeDistanceType="euclidianDistance" freespace')


def straight(name, x, y, heading, links="", length=50.0, junction="-1"):
    """Return a straight road with a lane to each side."""
    lane = '<lane id="{}" type="driving" level="false"><width sOffset="0" a="3.5" b="0" c="0" d="0"/></lane>'
    return f"""<road name="" length="{length}" id="{name}" junction="{junction}"><link>{links}</link>
<planView>
<geometry s="0" x="{x}" y="{y}" hdg="{heading}" length="{length}"><line/></geometry></planView><lanes>
<laneSection s="0"><left>{lane.format(1)}</left><center><lane id="0" type="none" level="false"/></center>
<right>{lane.format(-1)}</right></laneSection></lanes></road>"""
