"""Checks of packs: changed, missing and foreign files, and the rules of the notation."""

import pytest
from evidence_packs import make_pack, replace

from avrare.cli.main import main
from avrare_evidence.argument import Element, find_faults


@pytest.mark.parametrize(
    ("spoil", "fault"),
    [
        (
            lambda f: (f / "evidence/point/result.json").write_bytes(b"x"),
            "evidence/point/result.json: was changed",
        ),
        (lambda f: (f / "evidence/point/scenario.yaml").open("a").write("#"), "scenario.yaml: was changed"),
        (lambda f: (f / "evidence/point/provenance.json").unlink(), "provenance.json: is missing"),
        (lambda f: (f / "evidence/extra.txt").write_text(""), "evidence/extra.txt: is not in the manifest"),
    ],
)
def test_every_change_of_a_file_is_named(point, spoil, fault, capsys):
    pack = make_pack(point)
    spoil(pack.folder)
    assert main(["evidence", "--check", str(pack.folder)]) == 1
    assert fault in capsys.readouterr().out
    assert main(["confirm", str(pack.folder)]) == 4
    assert fault in capsys.readouterr().err


@pytest.mark.parametrize(
    ("spoil", "fault"),
    [
        (lambda f: (f / "manifest.json").unlink(), "it is not a pack, or its writing was interrupted"),
        (
            lambda f: replace(f, '"schema": 1', '"schema": "1"'),
            "manifest.json: it cannot be read: schema: Input should be 1",
        ),
        (
            lambda f: replace(f, '"point": {}', '"../../run-pack": {}'),
            "refers to evidence/../../run-pack/result.json, which has no digest",
        ),
        (
            lambda f: replace(f, '"point": {}', '"point": {"a": "/etc/x"}'),
            "refers to /etc/x, which has no digest",
        ),
        (
            lambda f: (f / "case.md").unlink() or (f / "case.md").symlink_to("/etc/hosts"),
            "case.md: is a link",
        ),
        (lambda f: (f / "case.gsn.yaml").write_text("a: ["), "case.gsn.yaml: cannot be read"),
    ],
)
def test_a_pack_that_leads_elsewhere_or_is_damaged_is_refused(point, spoil, fault, capsys):
    pack = make_pack(point)
    spoil(pack.folder)
    assert main(["confirm", str(pack.folder), "--seed", "3"]) == 4
    assert fault in capsys.readouterr().err


@pytest.mark.parametrize(
    ("change", "rule"),
    [
        ({"X1": {"text": "?"}}, "V01"),
        ({"G2": {"text": "without support"}}, "V02"),
        ({"G1": {"text": "top", "supportedBy": ["C1"]}}, "V04"),
        ({"G1": {"text": "top", "supportedBy": ["Sn1", "Sn1"]}}, "V05"),
        ({"G1": {"text": "top", "supportedBy": ["G1"]}}, "V06"),
        ({"G1": {"text": "top", "supportedBy": ["Sn1"], "defeated": True}}, "V10"),
        ({"S1": {"text": "s", "supportedBy": ["Sn1"], "challenges": "G1"}}, "V12"),
        ({"G2": {"text": "second top", "supportedBy": ["Sn1"]}}, "C01"),
        ({"G1": {"text": "top", "supportedBy": ["Sn9"]}}, "C03"),
        ({"G1": {"text": "top", "supportedBy": ["S1"]}, "S1": {"text": "s", "supportedBy": ["G1"]}}, "C04"),
    ],
)
def test_rules_of_the_notation(change, rule):
    case = {"G1": {"text": "top", "supportedBy": ["Sn1"], "inContextOf": ["C1"]}}
    case |= {"Sn1": {"text": "result"}, "C1": {"text": "scene"}}
    assert find_faults(read(case)) == []
    assert any(fault.startswith(rule) for fault in find_faults(read(case | change)))


def read(case):
    return {key: Element.model_validate(element) for key, element in case.items()}
