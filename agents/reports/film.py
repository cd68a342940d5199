"""Short films of episodes, with the seeds of the evaluation: of one episode, or of several side by side."""

import zlib
from collections import deque
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym
import imageio.v2 as imageio
import numpy as np
from numpy.typing import NDArray

from agents.evaluation.associators import metered
from agents.evaluation.drives import Driver
from agents.evaluation.episodes import ExploreArguments, run_episode
from agents.evaluation.records import stem
from agents.evaluation.tables import display_name
from slam_gym.association.prediction import Associator
from slam_gym.rendering import symbols
from slam_gym.rendering.canvas import pixels, pygame, text
from slam_gym.simulation.episode import Episode

FRAMES = 300
RATE = 20  # [frames/s]
BESIDE = "side-by-side"
SLOW = 8  # frames per tick, around a kidnapping and a recovery


def film_path(out: Path, agent: str) -> Path:
    """The file of an agent's film; its last picture has the same name with .png."""
    return out / "films" / f"{stem(agent)}.mp4"


def films_of(
    drivers: Sequence[Driver], arguments: ExploreArguments, episode: int, out: Path, associators: Sequence[str] = ()
) -> list[Callable[[], Path]]:
    """Calls that film an episode: one per agent, with its first model; with `associators`, which one agent drives with,
    a single one for all of them side by side. Films that exist already are left out."""
    films = {film_path(out, BESIDE if associators else driver.agent): driver for driver in reversed(drivers)}
    missing = [(path, driver) for path, driver in films.items() if not path.with_suffix(".png").exists()]
    return [partial(film, arguments, driver, episode, path, associators) for path, driver in missing]


def film(
    arguments: ExploreArguments, driver: Driver, episode: int, path: Path, associators: Sequence[str] = ()
) -> Path:
    """Film one episode to `path` (.mp4), and write its last picture beside it as .png, whose path is returned.

    With `associators`, films the same episode with each of them, side by side. The film has at most about `FRAMES`
    frames, and a pause at the first wrong pairing.
    """
    reels = [_shots(arguments, driver, episode, name and metered(name)[1]) for name in associators or [None]]
    return _cut(reels, path, [display_name(name) for name in associators])


class Shot(NamedTuple):
    """A picture of a film. It is compressed, since a film of several episodes needs all of them at once."""

    tick: int
    picture: bytes
    shape: tuple[int, ...]
    frames: int  # for which it is shown

    def pixels(self) -> NDArray[np.uint8]:
        return np.frombuffer(zlib.decompress(self.picture), np.uint8).reshape(self.shape)


def _shots(
    arguments: ExploreArguments, driver: Driver, episode: int, associator: Associator | str | None
) -> list[Shot]:
    """The shots of one episode, in the order of their ticks; the last shows the end of the episode."""
    agent, shots, wrong = driver.make(), list[Shot](), False
    env = arguments.make(agent.action, render_mode="rgb_array", associator=associator)
    stride = max(1, round(env.unwrapped.scenario.budget / FRAMES))  # type: ignore[attr-defined]

    def watch(env: gym.Env[Any, Any]) -> None:
        nonlocal wrong
        run = env.unwrapped.episode  # type: ignore[attr-defined]
        first_wrong, wrong = not wrong and run.identities.total.fp > 0, run.identities.total.fp > 0
        frames = RATE if first_wrong else SLOW if _is_slow(run) else 1
        if frames > 1 or run.ticks % stride == 0:
            shots.append(_shot(env, frames))

    run_episode(env, agent, episode, watch)
    shots.append(_shot(env, RATE))
    env.close()
    return shots


def _shot(env: gym.Env[Any, Any], frames: int) -> Shot:
    picture = np.asarray(env.render(), dtype=np.uint8)
    ticks: int = env.unwrapped.episode.ticks  # type: ignore[attr-defined]
    return Shot(ticks, zlib.compress(picture.tobytes(), 1), picture.shape, frames)


def _cut(reels: Sequence[Sequence[Shot]], path: Path, names: Sequence[str] = ()) -> Path:
    """Write the shots of episodes side by side, below their `names`: at each tick the latest shot of each episode, for
    the longest duration among the new ones."""
    path.parent.mkdir(parents=True, exist_ok=True)
    above = [np.hstack([_heading(name, reel[0].shape[1]) for name, reel in zip(names, reels)])] if names else []
    shown, left = [reel[0] for reel in reels], [deque(reel) for reel in reels]
    mp4 = {"codec": "libx264", "quality": 6, "macro_block_size": 2, "ffmpeg_log_level": "error"}
    with imageio.get_writer(path, fps=RATE, **mp4) as writer:
        while any(left):
            tick = min(reel[0].tick for reel in left if reel)
            now = [reel.popleft() if reel and reel[0].tick == tick else None for reel in left]
            shown = [new or old for new, old in zip(now, shown)]
            picture = np.vstack([*above, np.hstack([shot.pixels() for shot in shown])])
            for _ in range(max(shot.frames for shot in now if shot)):
                writer.append_data(picture)
    imageio.imwrite(path.with_suffix(".png"), picture)
    return path.with_suffix(".png")


def _heading(words: str, width: int) -> NDArray[np.uint8]:
    """A strip (32, width, 3) with words in the middle."""
    strip = pygame.Surface((width, 32), depth=32)
    strip.fill(symbols.PAPER)
    line = text(words, 18, symbols.INK, bold=True)
    strip.blit(line, ((width - line.get_width()) // 2, 6))
    return pixels(strip)


def _is_slow(episode: Episode) -> bool:
    """Whether the robot has just been carried away or relocated, so that the film slows down."""
    moments = (episode.kidnapping.happened, episode.kidnapping.recovered)
    return any(moment is not None and 0 <= episode.ticks - moment < 4 for moment in moments)
