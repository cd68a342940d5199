"""Draws the pictures of these pages: `python docs/pictures.py [NAME …]`, all of them by default.

The package itself draws them; the files are small and committed. Names are those of `PICTURES`, `film`, and `scenarios`
for the pictures of all scenarios. Needs the extra `agents`.
"""

import os
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

os.environ.setdefault("SDL_VIDEODRIVER", "dummy")
os.environ.setdefault("MPLBACKEND", "Agg")

import gymnasium as gym
import matplotlib.pyplot as plt
import numpy as np
from PIL import Image

import slam_gym  # noqa: F401 (registers the environments)
from agents.demo import ASSOCIATORS, WORLD, mapped, one_drive
from agents.drivers.base import make_agent, visible
from slam_gym.association import jcbb, nearest_neighbour
from slam_gym.geometry import compose, transform
from slam_gym.metrics.association import Decision
from slam_gym.rendering import symbols
from slam_gym.rendering.canvas import Canvas, fitting, pixels
from slam_gym.rendering.plot import plot_episode, plot_scan
from slam_gym.rendering.scene import Scene, draw_scene, scene_of_episode
from slam_gym.scenarios import SCENARIOS
from slam_gym.simulation.surveyed_field import surveyed_field
from slam_gym.slam.slam import Slam, SlamSpec
from slam_gym.types import UNPAIRED
from slam_gym.world import corridor

FOLDER = Path(__file__).parent / "pictures"
COLOURS = 256  # of a picture: few enough for small files
PAUSE = 14  # frames at the first wrong pairing of a film
SMALL = (200, 128)  # [pixels] of a picture in the list of scenarios
RED, BLUE, GREEN, GREY, INK = "#c8553d", "#2b6ca3", "#3a8a5c", "#b8bec6", "#2f3640"
STYLE = {
    "figure.dpi": 110, "font.size": 9.5, "axes.titlesize": 10, "axes.titleweight": "bold", "axes.edgecolor": GREY,
    "axes.spines.top": False, "axes.spines.right": False, "text.color": INK, "axes.labelcolor": INK,
}  # fmt: skip


def save(name: str, picture: Any, colours: int = COLOURS) -> None:
    """Write an array (h, w, 3) uint8, or the current figure of matplotlib (None), with few colours."""
    if picture is None:
        figure = plt.gcf()
        figure.canvas.draw()
        picture = np.asarray(figure.canvas.buffer_rgba())[:, :, :3]  # type: ignore[attr-defined]
        plt.close(figure)
    image = Image.fromarray(np.ascontiguousarray(picture))
    image = image.quantize(colours, Image.Quantize.MAXCOVERAGE, 2, dither=Image.Dither.NONE)  # keeps rare colours
    image.save(FOLDER / f"{name}.png", optimize=True)


# -- environments and scenarios --------------------------------------------------------------------------------------


def driven(scenario: str, ticks: int, world: int = 0, **arguments: Any) -> Any:
    """A test world, explored by information gain until `ticks` have passed or the budget is spent: the environment."""
    env = gym.make(
        "slam_gym/Explore-v0", scenario=scenario, split="test", render_mode="rgb_array", disable_env_checker=True,
        **arguments,
    )  # fmt: skip
    agent = make_agent("information_gain")
    agent.reset(world)
    observation, info = env.reset(seed=world, options={"world": world})
    driven, over = 0, False
    while driven < ticks and not over:
        observation, _, over, _, info = env.step(agent.act(observation, visible(info)))
        driven += info["ticks"]
    return env


def explore() -> Any:
    """The office after all its ticks."""
    return driven("office", 800).render()


def scenario(name: str) -> Any:
    """A world of a scenario after all its ticks. Saves a small picture of it as well."""
    arguments = {"relocation": "gcbb"} if name == "kidnapped" else {}
    env = driven(name, SCENARIOS[name].budget, world=1, **arguments)
    episode = env.unwrapped.episode
    all_of_it = scene_of_episode(episode)
    view = fitting(episode.site.plan.bounds, (0, 0, *SMALL), margin=0.5)
    canvas = Canvas(SMALL, *view, symbols.PAPER)
    shown = ("walls", "furniture", "people", "true_pose", "true_trail", "trail", "grid")
    draw_scene(canvas, Scene(**{name: getattr(all_of_it, name) for name in shown}))
    save(f"small_{name}", pixels(canvas.picture()), 32)
    return env.render()


def associate() -> Any:
    """A decision among many branches, of which the right one is not the nearest, of a robot with bad wheels."""
    wheels = {"odometry.turn_per_metre": 0.3, "odometry.turn_per_radian": 0.3}
    env: Any = gym.make(
        "slam_gym/Associate-v0", scenario="office", overrides=wheels, split="test", render_mode="rgb_array"
    ).unwrapped
    _, info = env.reset(seed=1)
    while info["action_mask"].sum() < 4 or env.walk.pairings < 3 or info["truth"]["action"] < 1:
        right = info["truth"]["action"]
        _, _, over, _, info = env.step(right if right >= 0 else env.K)
        if over:
            _, info = env.reset()
    return env.render()


def relocate() -> Any:
    """The last decision of an episode in which all earlier branches were right."""
    env = gym.make("slam_gym/Relocate-v0", scenario="office", render_mode="rgb_array", split="test", outside=0.0)
    _, info = env.reset(seed=3)
    over, picture = False, env.render()
    while not over:
        action = info["truth"]["action"]
        picture = env.render()
        _, _, over, _, info = env.step(action if action >= 0 else env.action_space.n - 2)  # type: ignore[attr-defined]
    return picture


# -- concepts --------------------------------------------------------------------------------------------------------


def compatibility() -> None:
    """Gates and pairings of nearest neighbour and JCBB where the reference corridor's loop closes."""
    slam = Slam(SlamSpec(reach=corridor.RANGE, locality=False))
    source_of: dict[int, int] = {}  # map feature -> true feature behind the measurement that created it
    for step, (odometry, scan, truth) in enumerate(corridor.walk_round(np.random.default_rng(7))):
        right = [source_of[i] for i in slam.map.ids.tolist()]
        features = np.array([right.index(int(source)) if source in right else UNPAIRED for source in truth.sources])
        done = slam.step(odometry, scan, partial(draw_both, features) if step == 40 else "jcbb")
        if step == 40:
            return
        source_of |= {int(i): int(s) for i, s, new in zip(done.ids, truth.sources, done.created) if new}


def draw_both(right: Any, scan: Any, prediction: Any) -> Any:
    """An associator that draws the pairings of nearest neighbour and JCBB, and returns JCBB's; `right` are the true."""
    answers = {"nearest neighbour": nearest_neighbour(scan, prediction), "JCBB": jcbb(scan, prediction)}
    _, axes = plt.subplots(1, 2, figsize=(8.7, 4.1), sharex=True, sharey=True, layout="constrained")
    for ax, (name, answer) in zip(axes, answers.items()):
        plot_scan(scan, prediction, answer, ax, right=replace(answer, features=right))
        wrong = int((answer.features != right).sum())
        ax.set(title=f"{name}: {wrong} of {len(scan)} wrong", xlabel="ahead [m]", xlim=(-0.45, 4.5), ylim=(-0.95, 3.3))
        ax.set_aspect("equal")
    axes[0].set_ylabel("to the left [m]")
    axes[0].plot([], [], "o", mfc="white", color=INK, ms=4.5, label="predicted feature, with its 99 % gate")
    axes[0].plot([], [], "x", color=INK, ms=6, mew=1.6, label="measurement")
    axes[0].plot([], [], color=GREEN, lw=2, label="paired rightly")
    axes[0].plot([], [], color=RED, lw=2, ls="--", marker="x", ms=8, mew=2.8, label="paired wrongly")
    axes[0].legend(frameon=False, loc="upper right", bbox_to_anchor=(1.0, 0.85))
    return answers["JCBB"]


def film() -> list[Image.Image]:
    """The frames of a film of one drive, mapped by nearest neighbour and by the default, side by side, with pauses."""
    speeds, every = one_drive("drift-3", WORLD), 5
    panels = [panels_of(speeds, name, every) for name in ASSOCIATORS]
    width = max(panel.width for side in panels for panel in side)
    frames = []
    for left, right in zip(*panels):
        frame = Image.new("RGB", (2 * width, left.height), "white")
        frame.paste(left, (0, 0))
        frame.paste(right, (width, 0))
        frames.append(frame)
        for side in (left, right):
            if "wrong" in side.info:
                frames += PAUSE * [frame]
    return frames


def panels_of(speeds: Any, associator: str, every: int) -> list[Image.Image]:
    """A picture after every `every` ticks of a drive that an associator maps: the map so far, and the pairings of the
    scan, green where they are right, red and thick where they are wrong. `info["wrong"]` marks the first with a wrong
    pairing."""
    panels: list[Image.Image] = []

    def watch(episode: Any) -> None:
        if not episode.ticks or (episode.ticks % every and episode.ticks != len(speeds)):
            return
        figure, ax = plt.subplots(figsize=(4.4, 3.3), dpi=100)
        figure.subplots_adjust(0.01, 0.01, 0.99, 0.87)
        plot_episode(episode, ax)
        here = compose(episode.base, episode.estimates[-1])
        for point, decision in zip(transform(here, episode.scan.points), episode.identities.decisions):
            if decision in (Decision.RIGHT, Decision.WRONG):
                wrong = decision == Decision.WRONG
                ax.plot(*np.stack([here[:2], point]).T, color=RED if wrong else GREEN, lw=2.2 if wrong else 0.8)
        ax.plot(*here[:2], marker=(3, 0, np.degrees(here[2]) - 90.0), color=RED, ms=10)
        x0, y0, x1, y1 = episode.site.plan.bounds
        ax.set(xticks=[], yticks=[], xlabel="", ylabel="", xlim=(x0 - 1.0, x1 + 3.0), ylim=(y0 - 1.5, y1 + 2.0))
        ax.spines[:].set_visible(False)
        name = "nearest neighbour" if associator == ASSOCIATORS[0] else "the default"
        figure.text(0.5, 0.945, name, ha="center", fontsize=12, weight="bold")
        tally, before = episode.identities.total, any("wrong" in panel.info for panel in panels)
        caption = f"map error {episode.map_error():.2f}, {tally.fp} of {tally.tp + tally.fp} pairings wrong"
        figure.text(0.5, 0.88, caption, ha="center", fontsize=9.5)
        figure.canvas.draw()
        panels.append(Image.fromarray(np.asarray(figure.canvas.buffer_rgba())[:, :, :3].copy()))  # type: ignore[attr-defined]
        if Decision.WRONG in episode.identities.decisions and not before:
            panels[-1].info["wrong"] = True
        plt.close(figure)

    mapped("drift-3", WORLD, speeds, watch=watch, associator=associator)
    return panels


def save_film(name: str, frames: list[Image.Image]) -> None:
    """Write a GIF that repeats, in the colours of its last frame, which is shown for three seconds."""
    last = frames[-1].quantize(48, Image.Quantize.MAXCOVERAGE, 2, dither=Image.Dither.NONE)
    few = [frame.quantize(palette=last, dither=Image.Dither.NONE) for frame in frames]
    durations = [90] * (len(few) - 1) + [3000]  # [ms]
    few[0].save(FOLDER / f"{name}.gif", save_all=True, append_images=few[1:], duration=durations, loop=0, optimize=True)


def locality() -> None:
    """Four localities of one feature in a map that was made in one pass."""
    area = surveyed_field(200, np.random.default_rng(5))
    first = int(np.argmin(np.hypot(*(area.landmarks.positions - [45.0, 50.0]).T)))
    titles = {
        "covisibility": "covisibility",
        "two hops": "two hops",
        "within 2r": "distance",
        "local maps": "local maps",
    }
    colours = (BLUE, GREEN, "#e0a030", "#7d5ba6")
    _, axes = plt.subplots(1, 4, figsize=(8.7, 2.6), layout="constrained", sharey=True)
    for ax, (name, title), colour in zip(axes, titles.items(), colours):
        members = area.locality(name).of(first)
        ax.plot(*area.path[:, :2].T, color="#e6e9ed", lw=2, zorder=0)
        ax.plot(*area.landmarks.positions.T, ".", ms=3, color=GREY)
        ax.plot(*area.landmarks.positions[members].T, "o", ms=4, color=colour)
        ax.plot(*area.landmarks.positions[first], "*", ms=12, color=INK)
        ax.set(title=f"{title}: {len(members)} of 200", aspect="equal", xlabel="x [m]")
    axes[0].set_ylabel("y [m]")


# -- command ---------------------------------------------------------------------------------------------------------

PICTURES: dict[str, Callable[[], Any]] = {
    "explore": explore,
    "associate": associate,
    "relocate": relocate,
    "compatibility": compatibility,
    "locality": locality,
} | {f"scenario_{name}": partial(scenario, name) for name in SCENARIOS}


def main(names: list[str]) -> int:
    """Draw the pictures of these names."""
    wanted = [
        name for name in PICTURES if not names or name in names or (name[:9] == "scenario_" and "scenarios" in names)
    ]
    if unknown := set(names) - set(wanted) - {"scenarios", "film"}:
        print(f"unknown: {', '.join(sorted(unknown))}; known: film, scenarios, {', '.join(PICTURES)}", file=sys.stderr)
        return 2
    with plt.rc_context(STYLE):
        if not names or "film" in names:
            save_film("film", film())
        for name in wanted:
            save(name, PICTURES[name]())
            print(f"{FOLDER / name}.png: {(FOLDER / f'{name}.png').stat().st_size // 1000} kB")
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
