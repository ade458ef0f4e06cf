"""Text from strangers made harmless: what a terminal would obey, or a reader not see, is spelt out."""

from __future__ import annotations

_CONTROLS = (*range(9), *range(11, 32), *range(127, 160))
_DIRECTIONS = (0x61C, 0x200E, 0x200F, *range(0x2028, 0x202F), *range(0x2066, 0x206A))
_SPELT = {code: f"\\x{code:02x}" for code in _CONTROLS} | {code: f"\\u{code:04x}" for code in _DIRECTIONS}


def spell_controls(text: str) -> str:
    """Spell out control characters but tab and line feed, and marks of the writing direction."""
    return text.translate(_SPELT)
