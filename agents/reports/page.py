"""The report of an evaluation: one page of HTML, made from its folder by the template of its kind.

Pictures are inside the page; only films lie beside it.
"""

from __future__ import annotations

import base64
import io
import json
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from matplotlib.figure import Figure

from agents.evaluation.pipeline import read_results
from agents.evaluation.records import undamaged, write_whole
from agents.evaluation.tables import cell, display_name
from agents.reports.contents import CONTENTS
from agents.reports.figures import colours

_PAGES = Environment(
    loader=FileSystemLoader(Path(__file__).with_name("templates")),
    autoescape=True,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)


def write_report(folder: Path) -> Path:
    """Write report.html into the folder of an evaluation, from the files there, and return its path.

    Raises ValueError where it holds none, or nothing finished yet.
    """
    results = read_results(folder)
    kind = results.metadata["kind"]
    if kind not in CONTENTS:
        raise ValueError(f"{folder} belongs to the {kind}, which makes its own page")
    template, content_of = CONTENTS[kind]
    with undamaged(f"results.csv or results.json of {folder}"):
        page = _PAGES.get_template(template).render(
            content_of(results, folder),
            colours=colours(results.names),
            complete=results.metadata["complete"],
            split=results.conditions.get("split"),
            provenance=json.dumps(results.metadata, indent=1, ensure_ascii=False),
        )
    write_whole(folder / "report.html", page)
    return folder / "report.html"


def data_url(picture: Figure | Path) -> str:
    """A figure, or a file .png, as the address of a picture inside the page."""
    buffer = io.BytesIO()
    if isinstance(picture, Figure):
        picture.savefig(buffer, format="png")
    png = buffer.getvalue() if isinstance(picture, Figure) else picture.read_bytes()
    return f"data:image/png;base64,{base64.b64encode(png).decode('ascii')}"


_PAGES.filters |= {"display_name": display_name, "data_url": data_url}
_PAGES.globals |= {"cell": cell}
