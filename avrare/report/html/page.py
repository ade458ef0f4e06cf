"""HTML page of a run: one self-contained file with style, script and data, from the model of the page."""

from __future__ import annotations

import base64
import hashlib
import json
from functools import cache
from importlib.resources import files
from typing import TYPE_CHECKING

from avrare.analysis.page.model import ReportModel
from avrare.base import number_format
from avrare.base.visible_text import spell_controls
from avrare.report.html import pictures

if TYPE_CHECKING:
    from jinja2 import Environment


def render_page(report: ReportModel) -> str:
    """Return the page of a run as HTML."""
    script = _read_asset("script.js")
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    template = load_templates().get_template("page.html")
    return template.render(report=report, style=_read_asset("style.css"), script=script, digest=digest) + "\n"


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
        loader=PackageLoader("avrare.report.html"),
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


def _read_asset(name: str) -> str:
    return files("avrare.report.html").joinpath(name).read_text(encoding="utf-8")
