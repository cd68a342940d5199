"""A canvas in metres: antialiased shapes on a supersampled pygame surface, shown as an array or in a window.

Needs the extra `render`.
"""

import functools
import math
import os
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import affine_transform, gaussian_filter

from slam_gym.geometry import observe
from slam_gym.rendering.walls import WIDTH, wall_lines
from slam_gym.types import Array

os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
try:
    import pygame
except ImportError as error:
    raise ImportError('drawing needs pygame-ce: pip install "slam_gym[render]"') from error

__all__ = ["TEXT", "Canvas", "Colour", "Window", "fitting", "pixels", "pygame", "text"]

Colour = tuple[int, int, int]

SUPERSAMPLING = 2
TEXT = 14  # [pixels] size of most text: at least 12 where a page shows a picture of 960 pixels on 830
_BROAD = 3  # [supersampled pixels] narrower lines are antialiased one by one, broader ones only by supersampling
_CIRCLE = np.stack([np.cos(np.linspace(0, 2 * np.pi, 37)), np.sin(np.linspace(0, 2 * np.pi, 37))])[:, :-1]  # (2, 36)
_FREE_SHARE = np.array([0.0, 1.0, 0.5])  # of unknown, free and wall cells: free space ends in the middle of walls
_SMOOTHING = 0.7  # [cells] standard deviation of the filter of free space
_SHARPNESS = 20.0  # of its border
_GATE_95 = 5.991  # squared Mahalanobis distance of the 95 % ellipse of a plane Gaussian: χ²_{2, .95}


def fitting(bounds: Array, room: tuple[int, int, int, int], margin: float = 0.0) -> tuple[tuple[float, float], float]:
    """Lower left corner [m] and scale [pixels/m] of a canvas that shows `bounds` (4,) [m] xmin ymin xmax ymax with a
    `margin` [m] as large as possible in the middle of `room`: left, bottom, width, height [pixels]."""
    (x0, y0, x1, y1), (left, bottom, width, height) = bounds.tolist(), room
    scale = min(width / max(x1 - x0 + 2.0 * margin, 1e-3), height / max(y1 - y0 + 2.0 * margin, 1e-3))
    return (0.5 * (x0 + x1) - (left + 0.5 * width) / scale, 0.5 * (y0 + y1) - (bottom + 0.5 * height) / scale), scale


class Canvas:
    """A picture of the plane. Positions are in metres with y up, line widths and marker radii in final pixels.

    `size` is (width, height) [pixels], `low` the position (x, y) [m] of the lower left corner.
    """

    def __init__(self, size: tuple[int, int], low: tuple[float, float], scale: float, background: Colour) -> None:
        self.size = size
        self.scale = scale  # [pixels/m]
        self.surface = pygame.Surface((size[0] * SUPERSAMPLING, size[1] * SUPERSAMPLING), depth=32)
        self.surface.fill(background)
        self._low = np.array(low)

    def picture(self) -> Any:
        """A surface of the canvas' size with everything that has been drawn."""
        return pygame.transform.smoothscale(self.surface, self.size)

    def _pixels(self, points: Array) -> Array:
        """Positions of `points` (…, 2) [m] in supersampled pixels, y down."""
        pixels: Array = (points - self._low) * (self.scale * SUPERSAMPLING)
        pixels[..., 1] = self.surface.get_height() - pixels[..., 1]
        return np.clip(pixels, -1e5, 1e5, out=pixels)  # distant points must not overflow pygame's integers

    def places(self, points: Array) -> list[tuple[float, float]]:
        """Positions of `points` (k, 2) [m] in the picture, in its pixels, y down."""
        return [(x / SUPERSAMPLING, y / SUPERSAMPLING) for x, y in self._pixels(points).tolist()]

    def polygons(self, shapes: Array, fill: Colour | None, line: Colour | None = None, width: float = 1.0) -> None:
        """Draw closed polygons (k, v, 2) [m]."""
        for shape in self._pixels(shapes).tolist():
            if fill is not None:
                pygame.draw.polygon(self.surface, fill, shape)
            if line is not None:
                pygame.draw.polygon(self.surface, line, shape, max(1, round(SUPERSAMPLING * width)))

    def segments(self, segments: Array, colour: Colour, width: float = 1.0) -> None:
        """Draw straight lines (s, 4) [m] x1 y1 x2 y2, which end half a width beyond their ends."""
        ends, thickness = self._pixels(segments.reshape(-1, 2, 2)), math.ceil(SUPERSAMPLING * width)
        along = ends[:, 1] - ends[:, 0]
        along *= 0.5 * thickness / np.maximum(np.hypot(along[:, 0], along[:, 1]), 1e-9)[:, None]
        draw = pygame.draw.aaline if thickness < _BROAD else pygame.draw.line
        for start, end in np.stack([ends[:, 0] - along, ends[:, 1] + along], axis=1).tolist():
            draw(self.surface, colour, start, end, thickness)

    def polyline(self, points: Array, colour: Colour, width: float = 1.0) -> None:
        """Draw a line through points (k, 2) [m], with gaps at points that are NaN."""
        pieces = np.concatenate([points[:-1], points[1:]], axis=1)
        self.segments(pieces[np.isfinite(pieces).all(axis=1)], colour, width)

    def dashes(self, points: Array, colour: Colour, width: float = 1.0) -> None:
        """Draw a dashed line through points (k, 2) [m], one dash per four widths, but at most 2 000."""
        if len(points) < 2:
            return
        along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
        step = max(4.0 * width / self.scale, along[-1] / 2000)
        start = np.arange(0.0, along[-1], step)
        end = np.minimum(start + 0.55 * step, along[-1])
        ends = [np.interp(lengths, along, points[:, axis]) for lengths in (start, end) for axis in (0, 1)]
        self.segments(np.stack(ends, axis=1), colour, width)

    def discs(
        self, points: Array, radius: float, fill: Colour | None, line: Colour | None = None, width: float = 1.0
    ) -> None:
        """Draw circles of `radius` [pixels] around points (k, 2) [m]."""
        r, w = SUPERSAMPLING * radius, max(1, round(SUPERSAMPLING * width))
        for centre in self._pixels(points).tolist():
            if fill is not None:
                pygame.draw.circle(self.surface, fill, centre, r)
            if line is not None:
                pygame.draw.circle(self.surface, line, centre, r + w / 2, w)

    def markers(self, points: Array, outline: Array, fill: Colour, line: Colour, width: float = 1.0) -> None:
        """Draw a small polygon with `outline` (v, 2) [pixels, y up] around each of points (k, 2) [m]."""
        self.polygons(points[:, None] + outline / self.scale, fill, line, width)

    def ellipses(
        self,
        points: Array,
        covariances: Array,
        fill: Colour | None,
        line: Colour | None,
        width: float = 1.0,
        gate: float = _GATE_95,
    ) -> None:
        """Draw the ellipses within which Gaussians with means (k, 2) [m] and covariances (k, 2, 2) [m²] have at most
        the squared Mahalanobis distance `gate`, by default 95 % ellipses."""
        values, vectors = np.linalg.eigh(covariances)
        radii = np.sqrt(gate * np.maximum(values, 0.0))
        outlines = np.swapaxes(vectors @ (radii[:, :, None] * _CIRCLE), 1, 2)
        self.polygons(points[:, None] + outlines, fill, line, width)

    def tint(self, points: Array, covariances: Array, colour: Colour) -> None:
        """Multiply the picture by `colour` in 95 % ellipses, as `ellipses`: what is below them can still be seen."""
        if len(points) == 0:
            return
        below, self.surface = self.surface, pygame.Surface(self.surface.get_size(), depth=32)
        self.surface.fill((255, 255, 255))
        self.ellipses(points, covariances, colour, None)
        below.blit(self.surface, (0, 0), special_flags=pygame.BLEND_RGB_MULT)
        self.surface = below

    def cells(self, codes: NDArray[np.uint8], free: Colour, wall: Colour, pose: Array, resolution: float) -> None:
        """Draw a grid of unknown (0), free (1) and wall (2) cells (h, w), row 0 lowest, of side `resolution` [m].

        `pose` (3,) is the pose of the grid's lower left corner. The grid may be turned against the pixels, where the
        sides of cells would look like saw teeth: free space has a smooth border instead, and walls are lines.
        """
        width, height = self.size
        squares = np.array([[1, height - 1], [3, height - 1], [1, height - 3]])  # centres of three, of 2 × 2 pixels
        first, right, below = observe(pose, self._low + squares / self.scale)[:, ::-1] / resolution - 0.5  # row, column
        share, axes = gaussian_filter(_FREE_SHARE[codes], _SMOOTHING), np.stack([right - first, below - first], axis=1)
        share = affine_transform(share, axes, first, (width // 2 + 1, height // 2 + 1), order=1)
        space = pygame.Surface(share.shape, pygame.SRCALPHA)
        space.fill(free)
        pygame.surfarray.pixels_alpha(space)[:] = 255 * np.clip(_SHARPNESS * (share - 0.5) + 0.5, 0.0, 1.0)
        self.surface.blit(pygame.transform.smoothscale_by(space, 2 * SUPERSAMPLING), (0, 0))
        (points, lines), broad = wall_lines(codes, pose, resolution), WIDTH * resolution * self.scale
        self.segments(lines, wall, broad)
        self.discs(points, 0.5 * broad, wall)


@functools.lru_cache(maxsize=512)
def text(words: str, size: int, colour: Colour, bold: bool = False) -> Any:
    """A surface with one line of text, `size` [pixels] high."""
    pygame.font.init()
    path = pygame.font.match_font("dejavusans,liberationsans,arial,helvetica", bold=bold)
    return pygame.font.Font(path, size).render(words, True, colour)


def pixels(picture: Any) -> NDArray[np.uint8]:
    """The pixels of a surface as a new array (h, w, 3)."""
    return np.ascontiguousarray(pygame.surfarray.array3d(picture).swapaxes(0, 1))


class Window:
    """A window that shows pictures in succession, at most `fps` per second, scaled to the size of the window."""

    def __init__(self, title: str, fps: float) -> None:
        self.title, self.fps, self._clock = title, fps, pygame.time.Clock()
        self._window: Any = None

    def show(self, picture: Any) -> None:
        """Show a surface. The first call opens the window in the size of its surface."""
        if self._window is None or pygame.display.get_surface() is None:  # another window has closed the display
            pygame.display.init()
            self._window = pygame.display.set_mode(picture.get_size(), pygame.RESIZABLE)
            pygame.display.set_caption(self.title)
        place = picture.get_rect().fit(self._window.get_rect())  # with its proportions, in the middle
        self._window.fill((0, 0, 0))
        self._window.blit(pygame.transform.smoothscale(picture, place.size), place)
        pygame.event.pump()
        pygame.display.flip()
        self._clock.tick(self.fps)

    def close(self) -> None:
        """Close the window, if it is open. May be called repeatedly; `show` opens a new window."""
        if self._window is not None:
            pygame.display.quit()
            self._window = None
