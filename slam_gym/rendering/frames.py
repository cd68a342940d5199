"""An episode as a `Frame` to draw: truth and estimate brought into W side by side."""

from __future__ import annotations

import numpy as np

from slam_gym.geometry import compose, rotate_covariances, transform
from slam_gym.rendering.explore_view import Frame
from slam_gym.simulation.episode import Episode, turned
from slam_gym.slam.relocation import RelocatingSlam
from slam_gym.types import NONE, Array

_TRAIL = 400  # points of a trail that are drawn
_LEAP = 1.5  # [m] from one of them to the next: nobody drove there


def frame_of(episode: Episode, goals: Array, *, covisibility: bool = False) -> Frame:
    """What the episode looks like now; `goals` (g, 2) in B are those on offer."""
    base, slam_map, plan = episode.base, episode.slam.map, episode.site.plan
    pose, landmarks = compose(base, slam_map.pose), transform(base, slam_map.positions)
    return Frame(
        walls=plan.walls,
        features=plan.features.positions,
        kinds=plan.features.kinds,
        furniture=episode.world.furniture,
        people=episode.world.people,
        robot_radius=episode.scenario.robot.radius,
        true_pose=episode.world.pose,
        true_trail=_trail(episode.poses),
        pose=pose,
        pose_covariance=turned(base, slam_map.pose_covariance),
        trail=transform(base, _trail(episode.estimates)),
        landmarks=landmarks,
        landmark_covariances=rotate_covariances(base[2], slam_map.covariances),
        provisional=slam_map.provisional,
        scan_points=transform(pose, episode.scan.points),
        decisions=episode.identities.decisions,
        paired_positions=_paired(episode, landmarks),
        path=transform(base, episode.path),
        goals=transform(base, goals),
        covisibility=episode.slam.covisibility.edges()[0] if covisibility else None,
        cells=episode.grid.cells,
        cells_origin=episode.grid.origin,
        cells_base=base,
        cells_resolution=episode.grid.resolution,
        title=f"{episode.scenario.name}, tick {episode.ticks} of {episode.scenario.budget}",
        panel=_panel(episode),
    )


def _trail(poses: list[Array]) -> Array:
    """Positions (≤ _TRAIL, 2) of the poses so far, the last among them; NaN where the robot did not drive."""
    every = max(1, len(poses) // _TRAIL)
    points = np.array([pose[:2] for pose in poses[::-1][::every][::-1]])
    leaps = np.flatnonzero(np.hypot(*np.diff(points, axis=0).T) > _LEAP) + 1
    trail: Array = np.insert(points, leaps, np.nan, axis=0)
    return trail


def _paired(episode: Episode, landmarks: Array) -> Array:
    """(m, 2) landmark that each measurement was paired with, NaN if none."""
    step, ids = episode.last_step, episode.slam.map.ids
    positions = np.full((len(step.ids), 2), np.nan)
    paired = (step.ids != NONE) & ~step.created & np.isin(step.ids, ids)
    positions[paired] = landmarks[np.searchsorted(ids, step.ids[paired])]
    return positions


def _panel(episode: Episode) -> tuple[tuple[str, str], ...]:
    tally, slam_map = episode.identities.total, episode.slam.map
    confirmed = int((~slam_map.provisional).sum())
    return (
        ("map error", f"{episode.map_error():.2f}"),
        ("explored", f"{100.0 * episode.coverage():.0f} %"),
        ("features mapped", f"{confirmed} of {len(episode.targets)}"),
        ("pairings right", f"{100.0 * tally.precision:.1f} %" if tally.tp + tally.fp else "–"),
        ("pose error", _length(np.hypot(*(compose(episode.base, slam_map.pose) - episode.world.pose)[:2]))),
        *_whereabouts(episode),
    )


def _length(metres: float) -> str:
    return f"{100.0 * metres:.0f} cm" if metres < 1.0 else f"{metres:.1f} m"


def _whereabouts(episode: Episode) -> tuple[tuple[str, str], ...]:
    """What was done to the robot, and what it makes of it; nothing where nobody carries robots away."""
    kidnapping = episode.kidnapping
    if episode.scenario.kidnapping is None and not isinstance(episode.slam, RelocatingSlam):
        return ()
    rows = () if kidnapping.happened is None else (("carried away", f"tick {kidnapping.happened}"),)
    if episode.slam.lost:
        return (*rows, ("robot", "is lost"))
    if episode.slam.doubted:
        return (*rows, ("robot", "in doubt"))
    if kidnapping.recovered is not None:
        return (*rows, ("found back", f"tick {kidnapping.recovered}"))
    return (*rows, ("robot", "tracks"))
