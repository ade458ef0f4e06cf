"""Pages of measured tables, which a study of fewer cells must not empty."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path


def fill(text: str, mark: str, lines: Iterable[str]) -> str:
    """Return a page with new lines between ``<!-- MARK -->`` and ``<!-- end of MARK -->``.

    Raises:
        ValueError: The page lacks one of the two.
    """
    begin, end = f"<!-- {mark} -->\n", f"<!-- end of {mark} -->"
    head, begins, rest = text.partition(begin)
    _, ends, tail = rest.partition(end)
    if not (begins and ends):
        raise ValueError(f"the page lacks {begin.strip()} or {end}")
    return "".join([head, begin, *(f"{line}\n" for line in lines), end, tail])


def put(page: Path, text: str, results: Path) -> bool:
    """Write a page anew, unless rows of its tables would be lost: then it is left beside the results.

    Results are not kept with the repository, so a fresh clone has the page and none of its cells.

    Args:
        page: Of the documentation.
        text: What it would say now.
        results: Folder of the study.

    Returns:
        Whether the page has been written.
    """
    old = _rows(page, page.read_text(encoding="utf-8")) if page.exists() else 0
    new = _rows(page, text)
    enough = new >= old
    where = page if enough else results / page.name
    where.write_text(text, encoding="utf-8")
    print(f"{where} written" + ("" if enough else f"; {page} stays, its tables have {old} rows, not {new}"))
    return enough


def _rows(page: Path, text: str) -> int:
    return sum(line.startswith("|") or page.suffix == ".csv" for line in text.splitlines())
