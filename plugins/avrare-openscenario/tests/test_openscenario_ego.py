"""The ego of a file: in reverse gear, and on a way that the file gives to it."""

from pathlib import Path

import numpy as np
import pytest

from avrare_openscenario.config import OpenScenarioConfig
from avrare_openscenario.simulator import OpenScenario
from openscenario_files import AT_ONE, document, drive, event, lane_position

FOLDERS = [folder / "shared" / "data" / "openscenario" / "ncap" for folder in Path(__file__).parents]
NCAP = next((folder for folder in FOLDERS if folder.is_dir()), None)


def test_an_ego_in_reverse_gear_is_driven_with_its_tail_as_its_front(build):
    text = document(ego=lane_position(60, -2), speed=0.0, ahead=1.4).replace(
        'value="20.0"', 'value="-3.0"', 1
    )
    world = build(text).reset(np.zeros((1, 0)))
    assert (world.ego.speed[0], world.ego.heading[0], world.ego.y[0]) == pytest.approx((3.0, 0.0, 0.0))
    assert world.others.x[0, 0] - world.ego.x[0] == pytest.approx(30.0)
    assert world.others.y[0, 0] == pytest.approx(3.5)
    assert np.cos(world.others.heading[0, 0]) == pytest.approx(-1.0)


def test_a_vehicle_is_synchronized_with_the_way_that_the_ego_has_left_on_its_trajectory(build):
    places = lane_position(10, -2), lane_position(60, -2), lane_position(60, -2, offset=-100)
    vertices = "".join(f"<Vertex><Position>{place}</Position></Vertex>" for place in places)
    target = (
        '<TrajectoryPosition s="110"><TrajectoryRef><Trajectory name="t" closed="false"><Shape><Polyline>'
        f"{vertices}</Polyline></Shape></Trajectory></TrajectoryRef></TrajectoryPosition>"
    )
    action = (
        f'<SynchronizeAction masterEntityRef="Ego"><TargetPositionMaster>{target}</TargetPositionMaster>'
        f"<TargetPosition>{lane_position(90)}</TargetPosition></SynchronizeAction>"
    )
    speed = drive(build(document(event(action, AT_ONE.replace("1.0", "0.0")))), 0.2)["speed"]
    assert speed[1, 0, 0] == pytest.approx(60.0 / 110.0 * 20.0, rel=0.02)


@pytest.mark.skipif(NCAP is None, reason="the scenes of Euro NCAP are not here")
def test_every_scene_of_euro_ncap_begins_with_an_ego():
    assert NCAP is not None
    files = [path for path in NCAP.rglob("NCAP_AEB_*_20??.xosc") if "Variations" not in path.parts]
    assert len(files) == 13
    for path in files:
        world = OpenScenario(OpenScenarioConfig(file=path, ignore_ego_events=True)).reset(np.zeros((1, 0)))
        assert world.ego.speed[0] > 0.0
