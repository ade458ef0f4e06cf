"""Scenes as they are found: how people and their tools vary what they write."""

import pytest

from avrare_openscenario.scenes_command import judge_scene, list_scenes
from openscenario_files import SCENARIOS, change_lane, document, event

PLAIN = document(event(change_lane()))


@pytest.fixture
def judge(tmp_path):
    def judge(content):
        motorway = (SCENARIOS / "openscenario" / "motorway.xodr").read_bytes()
        (tmp_path / "motorway.xodr").write_bytes(motorway)
        path = tmp_path / "scene.xosc"
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return judge_scene(str(path))

    return judge


@pytest.mark.parametrize(
    ("old", "new"),
    [
        *(('revMinor="2"', f'revMinor="{minor}"') for minor in "013"),
        ('filepath="motorway.xodr"', 'filepath=".\\\\motorway.xodr"'),
        ('Entities="false"', 'Entities="False"'),
        ('priority="parallel"', 'priority="$how"'),
        (
            "<RoadNetwork>",
            '<MonitorDeclarations><MonitorDeclaration name="m"/></MonitorDeclarations><RoadNetwork>',
        ),
        ("<Entities>", "<!-- people --><?tool x?><Entities>"),
        ("<OpenSCENARIO>", '<OpenSCENARIO xmlns="http://a.b" xmlns:xsi="http://c" xsi:schemaLocation="d">'),
        ("><", ">\r\n\t<"),
    ],
)
def test_variations_that_mean_the_same(judge, old, new):
    declared = (
        '<ParameterDeclaration name="how" parameterType="string" value="skip"/></ParameterDeclarations>'
    )
    text = PLAIN.replace("</ParameterDeclarations>", declared)
    assert old in text
    assert judge(text.replace(old, new)).status == "read"


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "iso-8859-1", "windows-1252"])
def test_encodings(judge, encoding):
    name = encoding.removesuffix("-sig")
    text = f'<?xml version="1.0" encoding="{name}"?>' + PLAIN.replace('author=""', 'author="Jürgen"')
    assert judge(text.encode(encoding)).status == "read"


def test_a_road_file_that_is_not_there_is_named_at_its_line(judge):
    finding = judge(PLAIN.replace("motorway", "highway"))
    assert (finding.line, finding.status) == (4, "refused")
    assert finding.reason.startswith("LogicFile: there is no road file ")


def test_catalogs_are_no_scenes(judge, tmp_path):
    judge(PLAIN)
    catalog = "<OpenSCENARIO><Catalog><StoryboardElementStateCondition/></Catalog></OpenSCENARIO>"
    (tmp_path / "catalog.xosc").write_text(catalog, encoding="utf-8")
    assert list_scenes([str(tmp_path)]) == [str(tmp_path / "scene.xosc")]
