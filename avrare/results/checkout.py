"""Commit of a folder, asked of git in a way that runs no program which the folder names."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

_ENVIRONMENT = {
    "GIT_OPTIONAL_LOCKS": "0",  # nothing is written
    "GIT_NO_LAZY_FETCH": "1",
    "GIT_ALLOW_PROTOCOL": "none",  # for versions that do not know the line above
    "GIT_TERMINAL_PROMPT": "0",
}


def describe_checkout(folder: Path) -> tuple[str | None, bool | None]:
    """Return the commit of a folder, and whether there are uncommitted changes; None where not known.

    The settings of an untrusted repository may name programs. Its filters cannot be switched off, so nothing
    is said about changes where it has any of its own.
    """
    code, commit = _git(folder, "rev-parse", "HEAD")
    if code != 0:
        return None, None
    filtering = r"^filter\..*\.(clean|smudge|process)$"
    code, filters = _git(folder, "config", "--show-scope", "--get-regexp", filtering)
    own_scopes = ("local\t", "worktree\t")
    if code not in (0, 1) or any(line.startswith(own_scopes) for line in filters.splitlines()):
        return commit, None
    code, changes = _git(folder, "status", "--porcelain", "--untracked-files=no", "--ignore-submodules=dirty")
    return commit, bool(changes) if code == 0 else None


def _git(folder: Path, *words: str) -> tuple[int, str]:
    off = ("core.fsmonitor=false", "core.hooksPath=/dev/null")
    command = ["git", *(word for option in off for word in ("-c", option)), *words]
    try:
        answer = subprocess.run(
            command,
            cwd=folder,
            env=os.environ | _ENVIRONMENT,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=10,
            check=False,
        )
    except (OSError, subprocess.SubprocessError):
        return -1, ""
    return answer.returncode, answer.stdout.strip()
