"""A page without scripts that looks like the report page."""

import html
from string import Template

from ._report_page import asset


def plain_page(title: str, body: str) -> str:
    """Write one HTML page that asks nothing of a network; `body` is HTML, `title` text."""
    return Template(asset("plain.html")).substitute(title=html.escape(title), style=asset("style.css"), body=body)
