"""Asking a stranger's repository for its commit runs none of the programs that its settings name."""

import subprocess

import pytest

from avrare.results.provenance import describe_checkout


@pytest.fixture
def repository(tmp_path, monkeypatch):
    """Return a repository with one committed file, and a function that runs git in it."""
    for name in ("GIT_CONFIG_GLOBAL", "GIT_CONFIG_SYSTEM"):
        monkeypatch.setenv(name, "/dev/null")
    folder = tmp_path / "repository"
    folder.mkdir()

    def git(*words, check=True):
        command = ["git", "-c", "user.name=n", "-c", "user.email=e", *words]
        done = subprocess.run(command, cwd=folder, check=check, capture_output=True, text=True)
        return done.stdout.strip()

    git("init", "-q")
    (folder / "s.yaml").write_text("name: a\n")
    git("add", "s.yaml")
    git("commit", "-q", "-m", "one")
    return folder, git


def test_commit_and_changes(repository, tmp_path):
    folder, git = repository
    assert describe_checkout(folder) == (git("rev-parse", "HEAD"), False)
    (folder / "s.yaml").write_text("name: b\n")
    assert describe_checkout(folder) == (git("rev-parse", "HEAD"), True)
    assert describe_checkout(tmp_path) == (None, None)
    assert describe_checkout(tmp_path / "absent") == (None, None)


@pytest.mark.parametrize("kind", ["fsmonitor", "filter", "filter of the worktree"])
def test_no_program_of_its_settings_is_run(repository, tmp_path, kind):
    folder, git = repository
    commit, marker = git("rev-parse", "HEAD"), tmp_path / "executed"
    program = f"touch {marker} #"
    if kind == "fsmonitor":
        git("config", "core.fsmonitor", program)
    else:
        place = "--local"
        if kind == "filter of the worktree":
            git("config", "extensions.worktreeConfig", "true")
            place = "--worktree"
        git("config", place, "filter.evil.clean", f"touch {marker}; cat")
        (folder / ".git" / "info").mkdir(exist_ok=True)
        (folder / ".git" / "info" / "attributes").write_text("* filter=evil\n")
    (folder / "s.yaml").write_text("name: c\n")
    git("status", check=False)
    assert marker.exists(), "the trap does not work"
    marker.unlink()
    (folder / "s.yaml").write_text("name: d\n")
    assert describe_checkout(folder) == (commit, True if kind == "fsmonitor" else None)
    assert not marker.exists()


def test_nothing_is_written_to_the_repository(repository):
    folder, _ = repository
    (folder / "s.yaml").touch()
    before = (folder / ".git" / "index").read_bytes()
    describe_checkout(folder)
    assert (folder / ".git" / "index").read_bytes() == before
