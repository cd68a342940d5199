"""Short films of episodes, with the seeds of the evaluation: of one episode, or of several side by side."""

import zlib
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import imageio.v2 as imageio
import numpy as np
from numpy.typing import NDArray

from agents.evaluation.episodes import Driver, ExploreArguments, run_episode
from agents.evaluation.records import stem
from agents.evaluation.tables import display_name
from slam_gym.rendering import symbols
from slam_gym.rendering.canvas import pixels, pygame, text
from slam_gym.rendering.panels import SIZE
from slam_gym.simulation.episode import Episode

FRAMES = 300
RATE = 20  # [frames/s]
BESIDE = "side-by-side"
SLOW = 8  # frames per tick, around a kidnapping and a recovery

Shot = tuple[bytes, int]
"""A picture, compressed since a film of several episodes needs all of them at once, and the frames that show it."""


def film_path(out: Path, agent: str) -> Path:
    """The file of an agent's film; its last picture has the same name with .png."""
    return out / "films" / f"{stem(agent)}.mp4"


def films_of(
    drivers: Sequence[Driver], arguments: ExploreArguments, episode: int, out: Path, associators: Sequence[str] = ()
) -> list[Callable[[], Path]]:
    """Calls that film an episode: one per agent, with its first model; with `associators`, which one agent drives with,
    a single one for all of them side by side. Films of agents that exist already are left out."""
    films = {film_path(out, BESIDE if associators else driver.agent): driver for driver in reversed(drivers)}
    missing = [(path, driver) for path, driver in films.items() if associators or not path.with_suffix(".png").exists()]
    return [partial(film, arguments, driver, episode, path, associators) for path, driver in missing]


def film(
    arguments: ExploreArguments, driver: Driver, episode: int, path: Path, associators: Sequence[str] = ()
) -> Path:
    """Film one episode to `path` (.mp4), and write its last picture beside it as .png, whose path is returned.

    With `associators`, films the same episode with each of them, side by side. The film has at most about `FRAMES`
    frames, and a pause at the first wrong pairing.
    """
    compared = [replace(arguments, associator=name) for name in associators] or [arguments]
    reels = [_shots(each, driver, episode) for each in compared]
    above = [[_heading(display_name(name))] for name in associators] or [[]]
    path.parent.mkdir(parents=True, exist_ok=True)
    mp4 = {"codec": "libx264", "quality": 6, "macro_block_size": 2, "ffmpeg_log_level": "error"}
    with imageio.get_writer(path, fps=RATE, **mp4) as writer:
        shown = [next(iter(reel.values())) for reel in reels]
        for tick in sorted(set().union(*reels)):
            now = [reel.get(tick) for reel in reels]
            shown = [new or old for new, old in zip(now, shown)]  # the latest of each episode
            pictures = [np.frombuffer(zlib.decompress(packed), np.uint8).reshape(-1, SIZE[0], 3) for packed, _ in shown]
            picture = _two_by_two([np.vstack([*heading, each]) for heading, each in zip(above, pictures)])
            for _ in range(max(shot[1] for shot in now if shot)):
                writer.append_data(picture)
    imageio.imwrite(path.with_suffix(".png"), picture)
    return path.with_suffix(".png")


def _shots(arguments: ExploreArguments, driver: Driver, episode: int) -> dict[int, Shot]:
    """The shots of one episode by their ticks; the last one, of the end, has the tick after it."""
    agent, shots, wrong = driver.make(), dict[int, Shot](), False
    env = arguments.make(agent.action, render_mode="rgb_array")
    run: Any = env.unwrapped
    stride = max(1, round(run.scenario.budget / FRAMES))

    def take(tick: int, frames: int) -> None:
        shots[tick] = zlib.compress(np.asarray(env.render(), np.uint8).tobytes(), 1), frames

    def watch(_: Any) -> None:
        nonlocal wrong
        before, wrong = wrong, run.episode.identities.total.fp > 0
        frames = RATE if wrong and not before else SLOW if _is_slow(run.episode) else 1
        if frames > 1 or run.episode.ticks % stride == 0:
            take(run.episode.ticks, frames)

    run_episode(env, agent, episode, watch)
    take(run.episode.ticks + 1, RATE)
    env.close()
    return shots


def _two_by_two(pictures: list[NDArray[np.uint8]]) -> NDArray[np.uint8]:
    """Pictures of one size two by two; the last stands alone if their number is odd."""
    if len(pictures) == 1:
        return pictures[0]
    blank = np.full_like(pictures[0], 255)
    pairs = zip(pictures[::2], [*pictures[1::2], blank])
    return np.vstack([np.hstack(pair) for pair in pairs])


def _heading(words: str) -> NDArray[np.uint8]:
    """A strip (32, w, 3), as wide as a picture, with words in the middle."""
    strip = pygame.Surface((SIZE[0], 32), depth=32)
    strip.fill(symbols.PAPER)
    line = text(words, 18, symbols.INK, bold=True)
    strip.blit(line, ((SIZE[0] - line.get_width()) // 2, 6))
    return pixels(strip)


def _is_slow(episode: Episode) -> bool:
    """Whether the robot has just been carried away or relocated, so that the film slows down."""
    moments = (episode.kidnapping.happened, episode.kidnapping.recovered)
    return any(moment is not None and 0 <= episode.ticks - moment < 4 for moment in moments)
