"""The view of `Explore-v0`: the whole floor, with figures and legend beside or below it."""

import math
from typing import Any, NamedTuple

import numpy as np

from slam_gym.geometry import compose, transform
from slam_gym.rendering import symbols
from slam_gym.rendering.canvas import Canvas, fitting, pygame, text
from slam_gym.rendering.panels import SIZE, Box, Figures, figures, scale_bar
from slam_gym.rendering.scene import Scene, draw_scene, legend, paired_positions, scene_of_episode, shown_in
from slam_gym.simulation.episode import Episode
from slam_gym.types import Array

_MARGIN = 16  # [pixels] around the plan, and within the panel
_SCALE_BAR = 14  # [pixels] height of the scale bar below the plan
_BESIDE = 246  # [pixels] width of a panel beside the map
_TITLE, _ROW = 52, 22  # [pixels] height of the title with what is around it, and of a row of figures


class Layout(NamedTuple):
    """The positions of map and panel, in pixels from the upper left, and the scale of the map."""

    map_size: tuple[int, int]
    low: tuple[float, float]  # [m] position of the map's lower left corner
    scale: float  # [pixels/m]
    panel: Box
    beside: bool  # the panel is beside the map, not below it
    legend: Any  # a surface


def draw(episode: Episode, goals: Array, *, covisibility: bool = False) -> Any:
    """A surface with the present state of an episode; `goals` (g, 2) in B are the legal ones."""
    scene = scene_of_episode(episode, goals=goals, covisibility=covisibility)
    if episode.truth.pose is episode.poses[-1]:  # else an error has ended the tick before the scan was decided
        scene = scene._replace(
            scan_points=transform(compose(episode.base, episode.slam.map.pose), episode.scan.points),
            decisions=episode.identities.decisions,
            paired_positions=paired_positions(episode.last_step, episode.slam.map.ids, scene.landmarks),
        )
    return draw_floor(scene, episode.site.plan.bounds, episode.scenario.name, _figures(episode))


def draw_floor(scene: Scene, bounds: Array, title: str = "", shown: Figures = ()) -> Any:
    """A surface with a scene that lies within `bounds` (4,) [m] xmin ymin xmax ymax, and figures beside it."""
    layout = arrange(bounds, len(shown), shown_in(scene))
    picture = pygame.Surface(SIZE, depth=32)
    picture.fill(symbols.PAPER)
    canvas = Canvas(layout.map_size, layout.low, layout.scale, symbols.PAPER)
    draw_scene(canvas, scene)
    picture.blit(canvas.picture(), (0, 0))
    scale_bar(picture, layout.map_size, layout.scale)
    _panel(picture, layout, title, shown)
    return picture


def arrange(bounds: Array, rows: int = 0, shown: frozenset[str] = frozenset()) -> Layout:
    """The layout that shows `bounds` (4,) [m] largest: with a panel beside the map, or below it.

    The panel contains `rows` figures and the legend for the fields that are `shown`.
    """
    width, height = SIZE
    below = max(_TITLE + math.ceil(rows / 2) * _ROW, legend(shown, False).get_height() + 2 * _MARGIN)
    layouts = []
    for beside, w, h in ((True, width - _BESIDE, height), (False, width, height - below)):
        room = _MARGIN, _MARGIN + _SCALE_BAR, w - 2 * _MARGIN, h - 2 * _MARGIN - _SCALE_BAR
        panel = (w, 0, _BESIDE, height) if beside else (0, h, width, below)
        layouts.append(Layout((w, h), *fitting(bounds, room), panel, beside, legend(shown, beside)))
    return max(layouts, key=lambda layout: layout.scale)


def _panel(picture: Any, layout: Layout, title: str, shown: Figures) -> None:
    """Draw title, figures and legend."""
    left, top, width, height = layout.panel
    edge = ((left, top), (left, top + height)) if layout.beside else ((left, top), (left + width, top))
    pygame.draw.line(picture, symbols.LINE, *edge)
    x, y, room = left + _MARGIN, top + _MARGIN - 3, width - 2 * _MARGIN
    if layout.beside:
        picture.blit(layout.legend, (x, top + height - _MARGIN - layout.legend.get_height()))
    else:
        room -= layout.legend.get_width() + 8
        picture.blit(layout.legend, (width - layout.legend.get_width(), y + 1))
    while text(title, 18, symbols.INK, bold=True).get_width() > room:
        title = f"{title[:-2]}…"
    picture.blit(text(title, 18, symbols.INK, bold=True), (x, y))
    figures(picture, shown, (x, y + 30), room, 1 if layout.beside else 2)


def _figures(episode: Episode) -> Figures:
    tally, slam_map = episode.identities.total, episode.slam.map
    error = float(np.hypot(*(compose(episode.base, slam_map.pose) - episode.world.pose)[:2]))
    distance = f"{100.0 * error:.0f} cm" if error < 1.0 else f"{error:.1f} m"
    return (
        ("tick", f"{episode.ticks} of {episode.scenario.budget}"),
        ("map error", f"{episode.map_error():.2f}"),
        ("explored", f"{100.0 * episode.coverage():.0f} %"),
        ("mapped", str(int((~slam_map.provisional).sum()))),
        ("true features", str(len(episode.targets))),
        ("paired right", f"{100.0 * tally.precision:.1f} %" if tally.tp + tally.fp else "–"),
        ("pose error", "–" if len(episode.slam.maps) > 1 else distance),  # where a second map lies is unknown
        *_whereabouts(episode),
    )


def _whereabouts(episode: Episode) -> Figures:
    """The kidnapping and the robot's reaction to it; empty without kidnapping and relocation."""
    kidnapping, slam = episode.kidnapping, episode.slam
    if episode.scenario.kidnapping is None and slam.relocator is None:
        return ()
    rows = () if kidnapping.happened is None else (("carried away", f"at {kidnapping.happened}"),)
    states = {"is lost": slam.lost, "in doubt": slam.doubted, "missed a loop": slam.missed_loop}
    states |= {"has several maps": len(slam.maps) > 1}
    for state, holds in states.items():
        if holds:
            return (*rows, ("robot", state))
    if kidnapping.recovered is not None:
        return (*rows, ("found back", f"at {kidnapping.recovered}"))
    return (*rows, ("robot", "tracks"))
