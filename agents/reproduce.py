"""Train what ships from nothing: `python -m agents.reproduce driver|associator [--quick] [--out DIR]`.

Writes DIR/NAME.npz and its card, and shows each figure of the training beside that of the card that ships, with the
interval that it should lie in; exit status 1 where one lies outside. `--quick` takes a small part of the worlds: it
shows that the training runs and learns, not that it comes to the same.
"""

from __future__ import annotations

import importlib
import math
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from typer import Argument, Option

from agents.cli import command, results_folder
from slam_gym import weights
from slam_gym.weights import Weights

_OUTSIDE = " — OUTSIDE"


def main(
    target: Annotated[Literal["associator", "driver"], Argument(help="What to train.")],
    quick: Annotated[bool, Option("--quick", help="A few worlds, a few minutes: that it runs and learns.")] = False,
    out: Annotated[Path | None, Option(metavar="DIR", help="By default results/reproduce-TIME.")] = None,
) -> int:
    """Train from nothing what ships, and compare."""
    module = importlib.import_module(f"agents.learning.{target}")
    found: Weights = module.reproduce(
        quick, f"python -m agents.reproduce {target}", lambda text: print(text, flush=True)
    )
    path = (out or results_folder("reproduce", resume=False)) / f"{target}.npz"
    weights.write(path, found)
    print(f"wrote {path}")
    if quick:
        print("\n".join(compared(found.card.metrics, {})))
        return 0
    card = weights.card_of(target)
    shipped = weights.load(target, card.version, card.inputs, card.shapes)
    print("\n".join(compared(found.card.metrics, card.metrics)))
    said, good = verdict(found, shipped)
    print(said)
    return 0 if good else 1


def compared(found: dict[str, Any], shipped: dict[str, Any]) -> list[str]:
    """A line for each figure: what was found, and what the card says, `estimate` within `low` … `high`."""
    lines = []
    for name, figure in found.items():
        line, card = f"{name}: {figure['estimate']:.4g}", shipped.get(name)
        if card is not None:
            inside = card["low"] <= figure["estimate"] <= card["high"]
            line += f"; shipped {card['estimate']:.4g} [{card['low']:.4g}, {card['high']:.4g}]"
            line += "" if inside else _OUTSIDE
        lines.append(line)
    return lines


def verdict(found: Weights, shipped: Weights) -> tuple[str, bool]:
    """Whether all figures lie within the card's, and how far the arrays are from those that ship."""
    lines = compared(found.card.metrics, shipped.card.metrics)
    outside = sum(line.endswith(_OUTSIDE) for line in lines)
    alike = all(found.arrays[name].shape == own.shape for name, own in shipped.arrays.items())
    far = max(float(np.abs(found.arrays[n] - own).max()) for n, own in shipped.arrays.items()) if alike else math.inf
    arrays = "the arrays that ship, bit for bit" if far == 0.0 else f"other arrays, by up to {far:.2g}"
    figures = f"{outside} of {len(lines)} figures OUTSIDE the card" if outside else "all figures within the card"
    return f"verdict: {figures}; {arrays}", not outside


app = command(main)

if __name__ == "__main__":
    app()
