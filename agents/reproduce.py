"""Train what ships from nothing: `python -m agents.reproduce driver|associator [--quick] [--out DIR]`.

Writes DIR/NAME.npz and its card, and shows each figure of the training beside that of the card that ships, with the
interval that it should lie in; exit status 1 where one lies outside. `--quick` takes a small part of the worlds: it
shows that the training runs and learns, not that it comes to the same.
"""

from __future__ import annotations

import argparse
import importlib
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.cli import program, results_folder, run_main
from slam_gym import weights
from slam_gym.weights import Weights

TARGETS: dict[str, str] = {
    "associator": "agents.learning.associator.reproduction:reproduce",
    "driver": "agents.learning.driver.reproduction:reproduce",
}
"""What ships, by the name of its weights, and the function that trains it: (quick, command, say) → `Weights`."""

Say = Callable[[str], None]
_OUTSIDE = " — OUTSIDE"


def parser() -> argparse.ArgumentParser:
    p = argparse.ArgumentParser(prog=program("agents.reproduce"), description="Train from nothing what ships.")
    p.add_argument("target", choices=TARGETS, help="what to train")
    p.add_argument("--quick", action="store_true", help="a few worlds, a few minutes: that it runs and learns")
    p.add_argument("--out", type=Path, metavar="DIR", help="default: results/reproduce-TIME")
    return p


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
    far = max((_farthest(found.arrays.get(name), own) for name, own in shipped.arrays.items()), default=0.0)
    arrays = "the arrays that ship, bit for bit" if far == 0.0 else f"other arrays, by up to {far:.2g}"
    figures = f"{outside} of {len(lines)} figures OUTSIDE the card" if outside else "all figures within the card"
    return f"verdict: {figures}; {arrays}", not outside


def _farthest(found: NDArray[Any] | None, shipped: NDArray[Any]) -> float:
    if found is None or found.shape != shipped.shape:
        return math.inf
    return float(np.abs(found - shipped).max(initial=0.0))


def figure(values: list[float]) -> dict[str, float]:
    """The mean over seeds, and three standard deviations of one seed, at least 2 % of it, to either side."""
    mean = math.fsum(values) / len(values)
    spread = math.sqrt(math.fsum((v - mean) ** 2 for v in values) / max(len(values) - 1, 1))
    margin = max(3.0 * spread, 0.02 * abs(mean))  # machines round differently
    return {"estimate": mean, "low": mean - margin, "high": mean + margin}


def main(argv: list[str]) -> int:
    a = parser().parse_args(argv)
    module, _, name = TARGETS[a.target].partition(":")
    reproduce: Callable[[bool, str, Say], Weights] = getattr(importlib.import_module(module), name)
    out = a.out or results_folder("reproduce", resume=False)
    found = reproduce(a.quick, f"python -m agents.reproduce {a.target}", lambda text: print(text, flush=True))
    path = out / f"{a.target}.npz"
    weights.write(path, found)
    print(f"wrote {path}")
    if a.quick:
        print("\n".join(compared(found.card.metrics, {})))
        return 0
    card = weights.card_of(a.target)
    shipped = weights.load(a.target, card.version, card.inputs, card.shapes)
    print("\n".join(compared(found.card.metrics, card.metrics)))
    said, good = verdict(found, shipped)
    print(said)
    return 0 if good else 1


if __name__ == "__main__":
    raise SystemExit(run_main(main))
