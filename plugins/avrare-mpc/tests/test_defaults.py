"""Meaning of `controller: {plugin: mpc}`, with and without numba."""

import importlib.util
import warnings

import pytest

from avrare.scenario.fingerprint import fingerprint
from avrare.scenario.load import load
from avrare_mpc import controller
from avrare_mpc.casadi_search import CasadiSearch
from avrare_mpc.config import MpcConfig
from avrare_mpc.controller import build

SCENARIO = """\
name: short
steps: 2
simulator: {plugin: single_track, ego: {x: 0.0, y: 1.75, speed: 20.0}}
tracker: {plugin: imm}
controller: {plugin: mpc}
specifications: {kept: {stl: "always (ego_speed > 0)"}}
"""


@pytest.fixture
def without_numba(monkeypatch):
    find = importlib.util.find_spec
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None if name == "numba" else find(name))
    controller._warn_of_casadi.cache_clear()


def test_with_numba_it_is_riccati_everywhere(monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: object())
    config = MpcConfig()
    assert (config.backend, config.search) == ("riccati", "everywhere")


def test_without_numba_it_is_casadi_which_is_told_once(without_numba, lane_change):
    assert (MpcConfig().backend, MpcConfig().search) == ("casadi", "everywhere")
    with pytest.warns(UserWarning, match="numba is not installed: the controller mpc uses casadi"):
        assert isinstance(build(MpcConfig(), lane_change.scene)._search, CasadiSearch)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        build(MpcConfig(), lane_change.scene)
    assert told == []


def test_the_backend_that_was_found_is_part_of_the_fingerprint(tmp_path, monkeypatch):
    path, found = tmp_path / "short.yaml", {}
    path.write_text(SCENARIO)
    find = importlib.util.find_spec
    for backend, spec in (("casadi", None), ("riccati", object())):
        monkeypatch.setattr(
            "importlib.util.find_spec", lambda name, spec=spec: spec if name == "numba" else find(name)
        )
        scenario = load(path)
        assert scenario.resolved["controller"]["backend"] == backend
        found[backend] = fingerprint(scenario)
        assert fingerprint(load(path, [f"controller.backend={backend}"])) == found[backend]
    assert found["casadi"] != found["riccati"]
