"""Templates: what is escaped, what is not, and what ends a block of data."""

import json
import math

import pytest
from markupsafe import Markup

from avrare.output.html.page import load_templates


def render(source, **values):
    return load_templates().from_string(source).render(values)


def test_text_and_attributes_are_escaped_and_markup_is_not():
    found = render(
        '<p class="{{ a }}">{{ b }}{{ c }}{{ 3 }}</p>', a="q\"'", b="a < b & c", c=Markup("<b>x</b>")
    )
    assert found == '<p class="q&#34;&#39;">a &lt; b &amp; c<b>x</b>3</p>'


def test_a_name_cannot_command_a_terminal_or_turn_the_text_around():
    found = render('<p title="{{ a }}">{{ b }}</p>', a="\x07", b="\x1b[31mred\u202e\n")
    assert found == '<p title="\\x07">\\x1b[31mred\\u202e\n</p>'


def test_names_that_are_joined_or_made_a_part_of_text_are_escaped():
    found = render(
        '{{ several | join(" · ") }} {{ name | replace("_", " ") }}', several=["<", "\x07"], name="<_"
    )
    assert found == "&lt; · \\x07 &lt; "


def test_no_text_ends_a_block_of_data():
    block = render("{{ it | data | safe }}", it={"name": "</script><script>alert(1)"})
    assert "<" not in block
    assert json.loads(block) == {"name": "</script><script>alert(1)"}
    with pytest.raises(ValueError, match="JSON"):
        render("{{ it | data | safe }}", it=math.nan)


def test_line_ends_and_indents_of_a_template_are_no_part_of_the_page():
    assert render("<ul>\n  <li>{{ a }}</li>\n</ul>\n", a="x\n  y") == "<ul><li>x\n  y</li></ul>"
