"""The pieces that every report is made of: tables, pictures, and how it was made. All of them are HTML."""

from __future__ import annotations

import base64
import html
from collections.abc import Iterator, Sequence
from pathlib import Path
from string import Template
from typing import Any, NamedTuple

from agents.evaluation.tables import Column, Table, Value, best_names, cell, display_name
from agents.reports.figures import colours
from slam_gym.metrics.statistics import Interval

TEMPLATE = Path(__file__).with_name("template.html")


class Report(NamedTuple):
    """What the kind of evaluation supplies."""

    title: str
    subtitle: str
    sections: list[str]  # HTML


def page(report: Report, content: dict[str, Any]) -> str:
    """The whole page, with everything inside it; `content` is that of results.json."""
    unfinished = "" if content["complete"] else " — unfinished"
    return Template(TEMPLATE.read_text(encoding="utf-8")).substitute(
        title=html.escape(report.title),
        subtitle=html.escape(report.subtitle + unfinished),
        sections="\n".join(report.sections),
        provenance=html.escape(provenance(content)),
    )


def heading(text: str) -> str:
    return f"<h2>{html.escape(text)}</h2>"


def note(markup: str) -> str:
    """A paragraph of small print."""
    return f'<p class="soft">{markup}</p>'


def card(markup: str) -> str:
    return f'<div class="card">{markup}</div>'


def image(png: bytes, alt: str, small: bool = False) -> str:
    """An image that is part of the page."""
    data, style = base64.b64encode(png).decode("ascii"), ' class="small"' if small else ""
    return f'<img{style} alt="{html.escape(alt)}" src="data:image/png;base64,{data}">'


def label(name: str, names: Sequence[str]) -> str:
    """A name with the dot of the colour that it has among all names of the report."""
    dot = f'<span class="dot" style="background:{colours(names)[name]}"></span>'
    return f"{dot}{html.escape(display_name(name))}"


def table(shown: Table, names: Sequence[str]) -> str:
    """A card with the table; bold are the best of each column, or the differences that are told apart from 0."""
    titles = [shown.corner, *(column.title for column in shown.columns)]
    lines = ["<tr>" + "".join(f"<th>{html.escape(title)}</th>" for title in titles) + "</tr>"]
    bold = {column.key: _bold_names(shown, column) for column in shown.columns}
    for name, row in shown.rows.items():
        cells = [_cell(row.get(c.key), c.digits, name in bold[c.key], shown.differences) for c in shown.columns]
        lines.append(f"<tr><td>{label(name, names)}</td>{''.join(cells)}</tr>")
    return card(f"<table>{''.join(lines)}</table>")


def _bold_names(shown: Table, column: Column) -> set[str]:
    values = {name: row[column.key] for name, row in shown.rows.items() if column.key in row}
    if not shown.differences:
        return best_names(values, column)
    return {name for name, v in values.items() if isinstance(v, Interval) and (v.low > 0.0 or v.high < 0.0)}


def _cell(value: Value | None, digits: int, bold: bool, signed: bool) -> str:
    if value is None:
        return "<td></td>"
    middle, interval = cell(value, digits, signed)
    below = f"<small>[{interval}]&nbsp;</small>" if interval else ""
    return f"<td{' class=best' if bold else ''}>{middle}{below}</td>"


def provenance(content: dict[str, Any]) -> str:
    """Commands, conditions, models and versions, as text."""
    commands = [f"{c['command']}    # {c['started']}, {c.get('seconds', '?')} s" for c in content["commands"]]
    first, split = content["asked"].get("first", 0), content["conditions"].get("split")
    episodes = f"{first} … {first + content['asked']['episodes'] - 1}"
    seeds = f"episode k = {episodes}: reset(seed=k, options={{'world': k}}) of the {split} split" if split else ""
    models = [f"{Path(path).name}: sha256 {about['sha256']}, {_training(about)}"
              for path, about in content.get("models", {}).items()]  # fmt: skip
    facts = [_facts(content["conditions"]), seeds, *models, _facts(content["versions"])]
    return "\n\n".join(filter(None, ["\n".join(commands), *facts]))


def _facts(facts: dict[str, Any]) -> str:
    """Whatever was left at its default, None or empty, is not worth a word."""
    return ", ".join(f"{name} {value}" for name, value in _flat(facts, "") if value not in (None, [], False))


def _flat(facts: dict[str, Any], prefix: str) -> Iterator[tuple[str, Any]]:
    """Names and values; those of fields within fields are dotted."""
    for name, value in facts.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value


def _training(model: dict[str, Any]) -> str:
    training = model.get("training", {})
    said = (training.get(key, "?") for key in ("timesteps", "scenario", "seed"))
    return "{} decisions on {}, seed {}".format(*said)
