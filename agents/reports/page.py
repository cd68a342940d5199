"""The report of an evaluation: one page of HTML, made from its folder.

Pictures are embedded in the page; films are separate files. The terminal shows the tables of the same page.
"""

from __future__ import annotations

import base64
import io
import json
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from agents.evaluation.pipeline import Results, read_results
from agents.evaluation.records import undamaged, write_whole
from agents.evaluation.tables import cell, display_name
from agents.reports.figures import colours
from agents.reports.pages import PAGES, Page, Part, Picture


def page_of(results: Results, folder: Path) -> Page:
    """The page of an evaluation. Raises ValueError for a kind with a page of its own, and for damaged results."""
    kind = results.metadata["kind"]
    if kind not in PAGES:
        raise ValueError(f"{folder} belongs to the {kind}, which makes its own page")
    with undamaged(f"results.csv or results.json of {folder}"):
        return PAGES[kind](results, folder)


def write_report(folder: Path, track: Callable[[Sequence[Part]], Iterable[Part]] = iter) -> Path:
    """Write report.html to the folder of an evaluation, from the files there, and return its path.

    Parts are drawn as they come out of `track`, which may show progress. Raises ValueError where the folder contains no
    evaluation, or no finished episode.
    """
    results = read_results(folder)
    page = page_of(results, folder)
    with undamaged(f"results.csv or results.json of {folder}"):
        text = _TEMPLATES.get_template("report.html").render(
            page=page,
            parts=track([*page.headline, *page.parts]),
            complete=results.metadata["complete"],
            split=results.conditions.get("split"),
            provenance=json.dumps(results.metadata, indent=1, ensure_ascii=False),
            colours=colours(results.names),
        )
    write_whole(folder / "report.html", text)
    return folder / "report.html"


def data_url(picture: Picture | Path) -> str:
    """A data URL with a figure, or with the contents of a .png file."""
    if isinstance(picture, Path):
        png = picture.read_bytes()
    else:
        buffer = io.BytesIO()
        picture.draw().savefig(buffer, format="png")
        png = buffer.getvalue()
    return f"data:image/png;base64,{base64.b64encode(png).decode('ascii')}"


_TEMPLATES = Environment(
    loader=FileSystemLoader(Path(__file__).with_name("templates")),
    autoescape=True,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)
_TEMPLATES.filters |= {"display_name": display_name, "data_url": data_url}
_TEMPLATES.globals |= {"cell": cell}
