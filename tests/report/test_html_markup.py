"""Markup: what is escaped, what is not, and minus signs."""

import json
import math

import pytest

from avrare.analysis.page.player import typeset_minus
from avrare.report.html.markup import Markup, json_block, tag


def test_text_and_attributes_are_escaped_and_markup_is_not():
    found = tag("p", "a < b & c", [tag("b", "x"), None, ("y", 3)], class_="q\"'", hidden=True, id=None)
    assert found == '<p class="q&quot;&#x27;" hidden>a &lt; b &amp; c<b>x</b>y3</p>'
    assert isinstance(found, Markup)


def test_a_name_cannot_command_a_terminal_or_turn_the_text_around():
    found = tag("p", "\x1b[31mred\u202e\n", title="\x07")
    assert found == '<p title="\\x07">\\x1b[31mred\\u202e\n</p>'


def test_no_text_ends_a_block_of_data():
    block = json_block({"name": "</script><script>alert(1)"})
    assert block.count("<") == 2
    inner = block[block.index(">") + 1 : block.rindex("<")]
    assert json.loads(inner) == {"name": "</script><script>alert(1)"}
    with pytest.raises(ValueError, match="JSON"):
        json_block(math.nan)


def test_hyphens_in_names_are_not_minus_signs():
    assert typeset_minus("a-b cut-in -0.5 (-3) x-1 1e-5") == "a-b cut-in −0.5 (−3) x-1 1e-5"
