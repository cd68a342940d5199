"""An episode as a `Frame` to draw: truth and estimate brought into W side by side."""

from __future__ import annotations

import numpy as np

from slam_gym.envs.episode import Episode, turned
from slam_gym.envs.rendering import Frame
from slam_gym.geometry import compose, rotate_covariances, transform
from slam_gym.types import NONE, Array

_TRAIL = 400  # points of a trail that are drawn


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
    """Positions (≤ _TRAIL, 2) of the poses so far, the last among them."""
    every = max(1, len(poses) // _TRAIL)
    return np.array([pose[:2] for pose in poses[::-1][::every][::-1]])


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
        ("pose error", f"{100.0 * np.hypot(*(compose(episode.base, slam_map.pose) - episode.world.pose)[:2]):.0f} cm"),
    )
