"""`jaxmocap report-page`: the report page of a result, written anew."""

from pathlib import Path
from typing import Annotated

import tyro

from ._arguments import Json
from ._output import say, show


def report_page(
    result: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR", help="Folder that track wrote.")],
    json: Json = False,
) -> int:
    """Write report.html into a result again: one page to judge it by, without a network. track writes it by itself."""
    from jaxmocap.viewers import report_page

    path = report_page(result, say=say)
    show({"page": path}, lambda: f"{path}: open it in a browser", json_wanted=json)
    return 0
