"""HTML pages of a run and of a catalogue: self-contained files, from their models."""

from __future__ import annotations

import base64
import hashlib
import json
from functools import cache
from importlib.resources import files
from typing import TYPE_CHECKING

from avrare.analysis.page.model import ReportModel
from avrare.analysis.page.rates_model import RatesModel
from avrare.base import number_format
from avrare.base.visible_text import spell_controls
from avrare.output.html import pictures

if TYPE_CHECKING:
    from jinja2 import Environment


def render_page(report: ReportModel) -> str:
    """Return the page of a run as HTML, with style, script and data."""
    script = _read_asset("script.js")
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    template = load_templates().get_template("page.html")
    return template.render(report=report, style=_read_asset("style.css"), script=script, digest=digest) + "\n"


def render_rates(page: RatesModel) -> str:
    """Return the page of a catalogue's rates as HTML, which has no script."""
    return (
        load_templates().get_template("rates.html").render(page=page, style=_read_asset("style.css")) + "\n"
    )


@cache
def load_templates() -> Environment:
    """Return the templates, which escape all text that they are given."""
    from jinja2 import Environment, PackageLoader, StrictUndefined
    from jinja2.ext import Extension

    class Joined(Extension):
        """Templates whose line ends and indents are left out of the page."""

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


def _read_asset(name: str) -> str:
    return files("avrare.output.html").joinpath(name).read_text(encoding="utf-8")
