"""Folders of runs and the files in them."""

from avrare.results.run_folder import choose, fresh


def test_runs_of_the_same_second_have_separate_folders(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    folders = [fresh(["lane_change"]) for _ in range(5)]
    assert len(set(folders)) == 5
    assert all(folder.is_dir() and folder.name.startswith("lane_change-") for folder in folders)


def test_several_scenarios_share_a_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert fresh(["one", "two"]).name.startswith("2-scenarios-")


def test_a_named_folder_is_reused(tmp_path):
    assert choose(tmp_path, "drive", several=False) == choose(tmp_path, "drive", several=False) == tmp_path
    assert choose(tmp_path, "drive", several=True) == tmp_path / "drive"
