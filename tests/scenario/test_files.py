"""What is in the files that options name is part of the scenario."""

from pathlib import Path

import pytest
from pydantic import BaseModel, Field

from avrare.plugin.component import Component
from avrare.scenario.fingerprint import changed_files, digests, fingerprint
from avrare.scenario.schema import Block, Scenario


class Options(BaseModel):
    model: str = Field(json_schema_extra={"file": True})
    rules: Path | None = Field(None, json_schema_extra={"file": True})
    note: str = ""


@pytest.fixture
def scenario(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)

    def make(**options):
        component = Component("simulator", "toy", "", "", "")
        block = Block("toy", component, Options(**options))
        return Scenario("s.yaml", "s", 1, block, {}, Block("mc", component, Options(model="shipped")), ())

    return make


def test_the_content_of_named_files_counts(scenario):
    Path("mine.npz").write_bytes(b"one")
    Path("rules.yaml").write_text("a")
    assert digests(scenario(model="shipped", note="mine.npz")) == {}
    named = scenario(model="mine.npz", rules="rules.yaml")
    before, first = digests(named), fingerprint(named)
    assert list(before) == ["simulator.model", "simulator.rules"]
    Path("mine.npz").write_bytes(b"two")
    after = digests(named)
    assert fingerprint(named) != first
    assert changed_files(before, after, ("simulator",)) == ["simulator.model: its file has changed"]
    assert changed_files(before, after, ("controller", "sim")) == []
    assert changed_files({}, after, ("simulator",)) == []
