"""`slam-gym reproduce driver|associator` trains the shipped driver or associator from nothing.

The command writes DIR/NAME.npz and its card, and shows each figure of the training beside that of the shipped card,
with the interval in which it should lie; the exit status is 1 where one lies outside. `--quick` uses a small part of
the worlds: it shows that the training runs and learns, not that its result is the same.
"""

import importlib
from pathlib import Path
from typing import Annotated, Any, Literal

from typer import Argument, Option

from agents.cli import command
from agents.evaluation.records import results_folder


def main(
    target: Annotated[Literal["associator", "driver"], Argument(help="What to train.")],
    quick: Annotated[
        bool, Option("--quick", help="A few worlds, a few minutes: checks that it runs and learns.")
    ] = False,
    output: Annotated[Path | None, Option(metavar="DIR", help="By default results/reproduce-TIME.")] = None,
) -> int:
    """Train the shipped driver or associator from nothing, and compare."""
    from slam_gym import weights

    out = output or results_folder("reproduce", resume=False)
    out.mkdir(parents=True, exist_ok=True)  # before a training of minutes or hours
    module = importlib.import_module(f"agents.learning.{target}")
    trained: weights.Weights = module.reproduce(
        quick, f"slam-gym reproduce {target}", lambda text: print(text, flush=True)
    )
    path = out / f"{target}.npz"
    weights.write(path, trained)
    print(f"wrote {path}")
    lines, outside = compared(trained.card.metrics, {} if quick else weights.card_of(target).metrics)
    print("\n".join(lines))
    if not quick:
        print(f"verdict: {f'{outside} of {len(lines)}' if outside else 'no'} figures OUTSIDE the card")
    return 1 if outside else 0


def compared(trained: dict[str, Any], shipped: dict[str, Any]) -> tuple[list[str], int]:
    """A line for each figure of a training, beside `estimate` and `low` … `high` of the shipped card; and the number of
    figures that lie outside."""
    lines, outside = [], 0
    for name, figure in trained.items():
        line, card = f"{name}: {figure['estimate']:.4g}", shipped.get(name)
        if card is not None:
            inside = card["low"] <= figure["estimate"] <= card["high"]
            outside += not inside
            line += f"; shipped {card['estimate']:.4g} [{card['low']:.4g}, {card['high']:.4g}]"
            line += "" if inside else " — OUTSIDE"
        lines.append(line)
    return lines, outside


app = command("reproduce", main, "associator --quick")

if __name__ == "__main__":
    app()
