"""Untrusted text made harmless: control and invisible characters are spelt out.

The same for names in documents: Markdown, spreadsheets, XML.
"""

from __future__ import annotations

import re

_CONTROLS = (*range(9), *range(11, 32), *range(127, 160))
_DIRECTIONS = (0x61C, 0x200E, 0x200F, *range(0x2028, 0x202F), *range(0x2066, 0x206A))
_HALVES = range(0xD800, 0xE000)  # of surrogate pairs, which UTF-8 cannot hold
_SPELT = {code: f"\\x{code:02x}" for code in _CONTROLS}
_SPELT |= {code: f"\\u{code:04x}" for code in (*_DIRECTIONS, *_HALVES)}
_SPELT_LINE = _SPELT | {ord("\n"): "\\x0a", ord("\t"): "\\x09"}
_MARKS = re.compile(r"([\\`*_{}\[\]()#|!~@])")
_ENTITIES = str.maketrans({"&": "&amp;", "<": "&lt;", ">": "&gt;"})
_NOT_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def spell_controls(text: str) -> str:
    """Spell out control characters but tab and line feed, marks of the writing direction, and half pairs."""
    return text if text.isprintable() else text.translate(_SPELT)


def spell_line(text: str) -> str:
    """Spell out tabs and line feeds as well: for a name on a line of its own."""
    return text if text.isprintable() else text.translate(_SPELT_LINE)


def escape_markdown(text: str) -> str:
    """Return text for Markdown, on one line, inside a table or out of it; nothing in it is markup."""
    return _MARKS.sub(r"\\\1", " ".join(spell_controls(text).split()).translate(_ENTITIES))


def escape_xml(text: str) -> str:
    """Return text that XML can hold; ElementTree escapes the markup."""
    return _NOT_XML.sub("\ufffd", spell_controls(text))


def escape_cell(text: str) -> str:
    """Escape text for a cell of a CSV file, so that no spreadsheet reads it as a formula."""
    line = spell_line(text)
    return f"'{line}" if line.lstrip().startswith(tuple("=+-@")) else line
