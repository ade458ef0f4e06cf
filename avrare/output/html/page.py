"""HTML pages of a run and of a catalogue: self-contained files, from their models."""

from __future__ import annotations

import base64
import hashlib

from avrare.analysis.page.model import ReportModel
from avrare.analysis.page.rates_model import RatesModel
from avrare.output.html.environment import load_templates, read_asset


def render_page(report: ReportModel) -> str:
    """Return the page of a run as HTML, with style, script and data."""
    script = read_asset("script.js")
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    template = load_templates().get_template("page.html")
    return template.render(report=report, style=read_asset("style.css"), script=script, digest=digest) + "\n"


def render_rates(page: RatesModel) -> str:
    """Return the page of a catalogue's rates as HTML, which has no script."""
    return load_templates().get_template("rates.html").render(page=page, style=read_asset("style.css")) + "\n"
