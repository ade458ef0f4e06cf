"""The program of docs/python.md runs."""

import re
from pathlib import Path

PAGE = Path(__file__).parents[3] / "docs" / "python.md"


def test_the_program_of_the_page_runs(tmp_path, monkeypatch, capsys):
    (program,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL)
    monkeypatch.chdir(tmp_path)
    exec(compile(program, "python.md", "exec"), {})
    assert "no_crawling" in capsys.readouterr().out
    assert (tmp_path / "failure.png").stat().st_size > 5000
    assert "Worst" in (tmp_path / "report.html").read_text(encoding="utf-8")
