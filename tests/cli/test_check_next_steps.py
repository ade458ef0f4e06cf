"""Lines of a check besides its verdicts: replay commands, sizes, annotations, folders of killed checks."""

import re
import shlex
from pathlib import Path

from avrare.cli.main import main

BOUND = "thresholds: [{specification: in_lane, probability: '< %s'}]\n"


def test_a_failing_row_names_its_failure_and_how_to_replay_it(drive, check, capsys):
    _, content = check(drive(BOUND % "0.02"))
    (row,) = content["rows"]
    assert re.fullmatch(
        r"failure [0-9a-f]{8}: a folder for the results keeps it for a replay", row["next_step"]
    )
    _, content = check("drive.yaml", "--out", "seen here")
    command = shlex.split(content["rows"][0]["next_step"].partition(": ")[2])
    assert command[:3] == ["avrare", "replay", "drive.yaml"]
    assert main(command[1:]) == 0
    assert f"{content['rows'][0]['next_step'][:16]} is reproduced" in capsys.readouterr().out


def test_an_inconclusive_row_says_how_many_rollouts_decide_it(drive, check):
    _, content = check(drive(BOUND % "0.055"))
    (row,) = content["rows"]
    command = shlex.split(row["next_step"].partition(" would decide it in 9 of 10 cases: ")[2])
    assert command[:4] == ["avrare", "check", "drive.yaml", "--budget"]
    rollouts = int(command[4].removeprefix("rollouts="))
    assert 5_000 < rollouts < 100_000
    assert check("drive.yaml", "--budget", f"rollouts={2 * rollouts}", "--seed", "3")[0] == 0


def test_github_shows_the_row_at_its_line(drive, monkeypatch, capsys, tmp_path):
    monkeypatch.setenv("GITHUB_ACTIONS", "true")
    monkeypatch.setenv("GITHUB_STEP_SUMMARY", str(tmp_path / "summary"))
    assert main(["check", drive(BOUND % "0.02")]) == 1
    line = next(line for line in capsys.readouterr().out.splitlines() if line.startswith("::"))
    pattern = r"::error (file=drive.yaml,line=\d+),title=drive in_lane < 0.02%3A fail::(.*)"
    place, text = re.fullmatch(pattern, line).groups()
    row = Path("drive.yaml").read_text().splitlines()[int(place.rpartition("=")[2]) - 1]
    assert "thresholds" in row
    assert "%0Afailure " in text
    assert "❌ fail" in (tmp_path / "summary").read_text()


def test_elsewhere_nothing_is_printed_for_github(drive, monkeypatch, capsys):
    monkeypatch.delenv("GITHUB_ACTIONS", raising=False)
    main(["check", drive(BOUND % "0.02")])
    assert "::error" not in capsys.readouterr().out


def test_a_folder_that_a_killed_check_left_is_taken(drive, check, monkeypatch, capsys):
    def killed(*_):
        raise KeyboardInterrupt

    words = [drive(BOUND % 0.1), "--out", "gate"]
    with monkeypatch.context() as patched:
        patched.setattr("avrare.cli.check.call_back", killed)
        main(["check", *words])
    assert Path("gate/result.json").exists()
    assert not Path("gate/check.json").exists()
    assert check(*words)[0] == 0
    assert sorted(path.name for path in Path("gate").iterdir() if path.suffix == ".json") == [
        "check.json", "provenance.json", "result.json",
    ]  # fmt: skip
    assert not Path("gate/unfinished").exists()
    assert main(["check", *words]) == 4
    assert "earlier command" in capsys.readouterr().err
