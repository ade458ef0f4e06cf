"""Files of which something is left out, altered, or put elsewhere: each is read, or refused at a line."""

import copy
import random
import shutil
import warnings
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from avrare.base.errors import UsageError
from avrare_openscenario.opendrive import read_opendrive
from avrare_openscenario.scenes_command import judge_scene
from openscenario_files import SCENARIOS

FOLDER = SCENARIOS / "openscenario"
TEXTS = (
    "",
    "nan",
    "-1",
    "0",
    "1e308",
    "-1e9",
    "abc",
    "$x",
    "${1/0}",
    "${",
    "inf",
    "2",
    "true",
    "Ego",
    "rate",
)
COUNT = 100
"""Variants of each file."""


def damage(chance, top):
    parents = [node for node in top.iter() if len(node)]
    parent = chance.choice(parents)
    place = chance.randrange(len(parent))
    match chance.choice(("remove", "copy", "empty", "move", "rename", "attribute", "text", "text")):
        case "remove":
            del parent[place]
        case "copy":
            parent.append(parent[place])
        case "empty" if parent is not top:
            parent[:] = []
        case "move":
            parent[place] = copy.deepcopy(chance.choice(parents)[0])
        case "rename":
            parent[place].tag = chance.choice(parents).tag
        case how:
            node = chance.choice([node for node in top.iter() if node.attrib])
            name = chance.choice(sorted(node.attrib))
            node.attrib.pop(name) if how == "attribute" else node.set(name, chance.choice(TEXTS))


@pytest.mark.parametrize("name", ["cut_in.xosc", "motorway_cut_ins.xosc", "motorway.xodr"])
def test_damaged_files_are_read_or_refused_at_a_line(tmp_path, name):
    for road in FOLDER.glob("*.xodr"):
        shutil.copy(road, tmp_path)
    chance, verdicts = random.Random(name), set()
    for _ in range(COUNT):
        tree = ET.parse(FOLDER / name)
        for _ in range(chance.choice((1, 1, 2, 3))):
            damage(chance, tree.getroot())
        path = tmp_path / f"damaged{Path(name).suffix}"
        tree.write(path)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            verdicts.add(judge(path))
    assert verdicts == {"read", "refused"}


def judge(path):
    if path.suffix == ".xosc":
        finding = judge_scene(str(path))
        assert finding.status != "refused" or finding.line is not None, finding.reason
        return "refused" if finding.status == "refused" else "read"
    verdict = "read"
    try:
        read_opendrive(str(path))
    except UsageError as error:
        verdict = "refused" if error.message.startswith(f"{path}:") else error.message
    return verdict
