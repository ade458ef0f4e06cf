"""HTML page of a run: one self-contained file with style, script and data, from the model of the page."""

from __future__ import annotations

import base64
import hashlib

from avrare.analysis.page.model import ReportModel
from avrare.output.html.environment import load_templates, read_asset


def render_page(report: ReportModel) -> str:
    """Return the page of a run as HTML."""
    script = read_asset("script.js")
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    template = load_templates().get_template("page.html")
    return template.render(report=report, style=read_asset("style.css"), script=script, digest=digest) + "\n"
