"""Road files as they are found: borders in place of widths, joints that nearly fit."""

import numpy as np
import pytest

from avrare.base.errors import UsageError
from avrare_openscenario.opendrive import read_opendrive

WIDTH = '<width sOffset="0" a="3.5" b="0" c="0" d="0"/>'
LINE = '<geometry s="0" x="0" y="0" hdg="0" length="100"><line/></geometry>'
CENTRE = '<center><lane id="0" type="none"/></center>'


def road(lanes, geometry=LINE, name="1", more="", link=""):
    right = "".join(f'<lane id="{-k}" type="driving">{lane}</lane>' for k, lane in enumerate(lanes, 1))
    return (
        f'<road id="{name}" length="100" junction="-1">{link}<planView>{geometry}</planView>{more}'
        f'<lanes><laneSection s="0">{CENTRE}<right>{right}</right></laneSection></lanes></road>'
    )


@pytest.fixture
def read(tmp_path):
    def read(content):
        path = tmp_path / "road.xodr"
        path.write_text(f'<OpenDRIVE><header revMajor="1"/>{content}</OpenDRIVE>', encoding="utf-8")
        return read_opendrive(str(path))

    return read


def test_borders_are_places_beside_the_reference_line(read):
    borders = [f'<border sOffset="0" a="{a}" b="-0.01" c="0" d="0"/>' for a in (-3.0, -7.0)]
    (roads,) = read(road(borders)).maps
    left, right = roads.borders(roads.lanes[-2], np.array([0.0, 50.0]))
    np.testing.assert_allclose(left, [-3.0, -3.5])
    np.testing.assert_allclose(right, [-7.0, -7.5])
    (both,) = read(road([WIDTH + borders[1]])).maps  # a width counts more than a border
    assert both.road.lane_centres == (-1.75,)


def test_a_lane_without_width_has_none_and_is_noted(read):
    network = read(road([WIDTH, "", WIDTH]))
    assert network.maps[0].centres == {-3: -5.25, -2: -3.5, -1: -1.75}
    assert [note.split(": ", 1)[1] for note in network.notes] == ["lane: has no width"]


def test_pieces_that_nearly_meet_make_a_line_of_points(read):
    first = LINE.replace('length="100"', 'length="50"')
    second = '<geometry s="50" x="50.05" y="{y}" hdg="0.01" length="50"><arc curvature="0.01"/></geometry>'
    network = read(road([WIDTH], first + second.format(y=0.04)))
    headings = network.maps[0].line.heading(np.linspace(0.0, 99.0, 400))
    assert np.abs(np.diff(headings)).max() < 0.06
    assert "begins 0.064 m and 0.01 rad from the end" in network.notes[0]
    with pytest.raises(UsageError, match=r"begins 0\.602 m and 0\.01 rad from the end"):
        read(road([WIDTH], first + second.format(y=0.6)))


@pytest.mark.parametrize(
    "more",
    [
        "<railroad><switch id='1' name='s' position='dynamic'/></railroad>",
        "<CRG file='a.crg' sStart='0' sEnd='10'/>",
    ],
)
def test_what_changes_nothing_is_skipped(read, more):
    empty = '<geometry s="100" x="100" y="0" hdg="0" length="0"><line/></geometry>'
    network = read(road([WIDTH], LINE + empty, more=more) + "<station id='1' name='s' type='small'/>")
    assert network.maps[0].line.length == 100.0


def test_a_junction_with_the_id_of_a_road_is_no_road(read):
    link = "<link><successor elementType='junction' elementId='2'/></link>"
    onward = road([WIDTH], LINE.replace('x="0"', 'x="100"'), name="2")
    network = read(road([WIDTH], link=link) + onward + "<junction id='2' name='j'/>")
    assert [list(line.begins) for line in network.maps] == [["1"], ["2"]]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (road([WIDTH]) * 2, "road: a second road '1'"),
        (road([WIDTH], LINE.replace('"100"', '"1e12"')), "geometry: the road is longer than 1000 km"),
        (road([WIDTH], ""), "road: has no geometry"),
        (
            road([WIDTH], LINE.replace("<line/>", "<poly3 a='0' b='1e300' c='1e306' d='0'/>")),
            "road: has no geometry, or none of finite length",
        ),
    ],
)
def test_roads_that_cannot_be_are_named_at_their_place(read, content, message):
    with np.errstate(all="ignore"), pytest.raises(UsageError, match=r"road\.xodr:1:\d+: " + message):
        read(content)


def test_a_section_far_away_costs_nothing(read):
    sections = (
        f'<laneSection s="0">{CENTRE}<right><lane id="-1" type="bus">{WIDTH}</lane></right></laneSection>'
    )
    wide = WIDTH.replace('b="0"', 'b="0.001"')
    far = sections.replace('s="0"', 's="1e12"', 1).replace(WIDTH, wide)
    content = road([WIDTH])
    begin = content.index("<laneSection")
    content = content[:begin] + sections.replace(WIDTH, wide) + far + "</lanes></road>"
    (roads,) = read(content).maps
    assert roads.road.lanes[0].stations[-1] == 100.0
