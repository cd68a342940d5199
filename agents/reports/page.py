"""The report of an evaluation: one page of HTML, made from its folder by the template of its kind.

Pictures are inside the page; only films lie beside it.
"""

from __future__ import annotations

import base64
import io
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

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
    if results.kind not in CONTENTS:
        raise ValueError(f"{folder} belongs to the {results.kind}, which makes its own page")
    with undamaged(f"results.csv or results.json of {folder}"):
        page = _PAGES.get_template(f"{results.kind}.html").render(
            CONTENTS[results.kind](results, folder),
            colours=colours(results.names),
            complete=results.metadata["complete"],
            provenance=provenance(results.metadata),
        )
    write_whole(folder / "report.html", page)
    return folder / "report.html"


def provenance(metadata: Mapping[str, Any]) -> str:
    """Commands, conditions, models and versions, as text."""
    commands = [f"{c['command']}    # {c['started']}, {c.get('seconds', '?')} s" for c in metadata["commands"]]
    episodes, split = metadata["evaluated"]["episodes"], metadata["conditions"].get("split")
    seeds = f"episode k: reset(seed=k, options={{'world': k}}) of the {split} split, k = {episodes[0]} … {episodes[-1]}"
    models = [
        f"{Path(path).name}: sha256 {about['sha256']}, {_facts(about.get('training', {}))}"
        for path, about in metadata.get("models", {}).items()
    ]
    facts = [_facts(metadata["conditions"]), seeds if split else "", *models, _facts(metadata["versions"])]
    return "\n\n".join(filter(None, ["\n".join(commands), *facts]))


def _facts(facts: Mapping[str, Any]) -> str:
    """Whatever was left at its default, None or empty, is not worth a word."""
    return ", ".join(f"{name} {value}" for name, value in _flat(facts, "") if value not in (None, [], False))


def _flat(facts: Mapping[str, Any], prefix: str) -> Iterator[tuple[str, Any]]:
    """Names and values; those of fields within fields are dotted."""
    for name, value in facts.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value


def data_url(picture: Figure | Path) -> str:
    """A figure, or a file .png, as the address of a picture inside the page."""
    buffer = io.BytesIO()
    if isinstance(picture, Figure):
        picture.savefig(buffer, format="png")
    png = buffer.getvalue() if isinstance(picture, Figure) else picture.read_bytes()
    return f"data:image/png;base64,{base64.b64encode(png).decode('ascii')}"


_PAGES.filters |= {"display_name": display_name, "data_url": data_url}
_PAGES.globals |= {"cell": cell}
