"""Templates of the pages, and the files that a page contains."""

from __future__ import annotations

import json
from functools import cache
from importlib.resources import files
from typing import TYPE_CHECKING

from avrare.base import number_format
from avrare.base.visible_text import spell_controls
from avrare.output.html import pictures

if TYPE_CHECKING:
    from jinja2 import Environment


@cache
def load_templates() -> Environment:
    """Return the templates, which escape all text that they are given."""
    from jinja2 import Environment, PackageLoader, StrictUndefined
    from jinja2.ext import Extension

    class Joined(Extension):
        """Templates whose line ends and indents are no part of the page."""

        def preprocess(self, source: str, name: str | None, filename: str | None = None) -> str:
            return "".join(map(str.strip, source.splitlines()))

    environment = Environment(
        loader=PackageLoader("avrare.output.html"),
        autoescape=True,
        undefined=StrictUndefined,
        finalize=_spell,
        extensions=[Joined],
    )
    environment.globals["pictures"] = pictures
    environment.filters |= {
        "typeset": number_format.format_typeset,
        "typeset_interval": number_format.format_typeset_interval,
        "percent": number_format.format_percent,
        "data": _encode_data,
        "number": pictures.format_number,
    }
    return environment


def _spell(value: object) -> object:
    # Control characters of names; markup of other templates holds none any more.
    return spell_controls(value) if type(value) is str else value


def _encode_data(content: object) -> str:
    # No text in it can end the block of the script.
    text = json.dumps(content, separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c")


def read_asset(name: str) -> str:
    """Return the text of a file beside the templates."""
    return files("avrare.output.html").joinpath(name).read_text(encoding="utf-8")
