"""The folder of failures."""

from dataclasses import replace

import numpy as np
import pytest

from avrare.analysis.failures.failure import record_failure
from avrare.analysis.failures.storage import FailureDatabase
from avrare.base.errors import UsageError


@pytest.fixture
def failure(linear, pushed):
    return record_failure(linear, "near", pushed)


@pytest.fixture
def database(tmp_path):
    return FailureDatabase(tmp_path / "some" / "failures")


def test_a_failure_is_kept_once_and_read_to_the_bit(database, failure):
    assert database.ids() == []
    assert database.add(failure)
    assert not database.add(replace(failure, versions={"avrare": "9"}))
    assert database.ids() == [failure.id]
    again = database.load(failure.id[:3])
    assert (again.id, again.versions) == (failure.id, failure.versions)
    np.testing.assert_array_equal(again.noise, failure.noise, strict=True)
    np.testing.assert_array_equal(again.values, failure.values, strict=True)


def test_failures_of_one_scenario(database, failure):
    database.add(failure)
    database.add(replace(failure, scenario="other", noise=failure.noise + 1.0))
    assert [one.id for one in database.load_all("double_integrator")[0]] == [failure.id]
    assert len(database.load_all()[0]) == 2


def test_names_that_fit_none_or_several(database, failure):
    with pytest.raises(UsageError, match="unknown failure 'abc'") as caught:
        database.load("abc")
    assert "avrare run --failures" in caught.value.hint
    database.add(failure)
    for name in ("zz", "../etc", "", failure.id + "0"):
        with pytest.raises(UsageError, match="unknown failure") as caught:
            database.load(name)
        assert failure.id in caught.value.hint
    (database.folder / f"{failure.id[:7]}{'0' if failure.id[7] != '0' else '1'}.npz").touch()
    with pytest.raises(UsageError, match="is ambiguous"):
        database.load(failure.id[:4])


def test_damaged_files_are_named_and_do_not_hide_the_others(database, failure):
    database.add(failure)
    whole = (database.folder / f"{failure.id}.npz").read_bytes()
    contents = {
        "00000001": b"",
        "00000002": whole[:300],
        "00000003": whole,
        "00000004": b"PK\3\4" + bytes(90),
    }
    for name, content in contents.items():
        (database.folder / f"{name}.npz").write_bytes(content)
    np.savez(database.folder / "00000005.npz", header=np.array(["a", {}], dtype=object))
    np.savez(database.folder / "00000006.npz", header=np.array("{}"))
    found, complaints = database.load_all()
    assert [one.id for one in found] == [failure.id]
    assert len(complaints) == 6
    for name, line in zip(sorted(contents), complaints, strict=False):
        assert f"{name}.npz: " in line
        assert "\n" not in line
    assert f"it holds failure {failure.id}" in complaints[2]


def test_a_folder_that_cannot_be_created(tmp_path, failure):
    (tmp_path / "file").touch()
    with pytest.raises(UsageError, match="cannot write"):
        FailureDatabase(tmp_path / "file" / "x").add(failure)


def test_checking_the_folder_does_not_create_it(database, tmp_path):
    database.ensure_writable()
    assert not database.folder.exists()
    (tmp_path / "file").touch()
    for folder in (tmp_path / "file", tmp_path / "file" / "deep" / "er"):
        with pytest.raises(UsageError, match="not a writable folder"):
            FailureDatabase(folder).ensure_writable()
