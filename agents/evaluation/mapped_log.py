"""EKF-SLAM over logs: the run from first to last step, its measures, the files with its results, and the evaluation of
every associator on every log.

LOG.reference.csv           all positions of the reference during the log
LOG.reference.tum           poses of the reference, where it has headings
LOG.ASSOCIATOR.tum          poses of the robot, in the frame of its map
LOG.ASSOCIATOR.map.csv      features of the map, in the same frame, and aligned rigidly with the reference
LOG.ASSOCIATOR.errors.csv   the positions, aligned likewise, and their errors against the reference
LOG.landmarks.csv           the true landmarks, where they are known
"""

import math
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from agents.evaluation.associators import contenders, hashes_of, metered
from agents.evaluation.pipeline import Evaluation, Key, Task
from agents.evaluation.records import Record, stem, write_whole
from agents.options import Recorded
from slam_gym.geometry import compose, inverse, transform
from slam_gym.mapping.smoothing import smooth
from slam_gym.metrics.association import Tally
from slam_gym.metrics.consistency import anees, pose_nees
from slam_gym.metrics.map_quality import align_se2, ate, landmark_rmse
from slam_gym.recordings import PUBLISHED, open_recordings
from slam_gym.recordings.recording import Recording, interpolate, write_tum
from slam_gym.scenarios import slam_for
from slam_gym.simulation.judged import CEILING, JudgedSlam
from slam_gym.slam.atlas import AtlasSpec
from slam_gym.slam.relocate import relocate_by
from slam_gym.slam.slam import Slam, SlamSpec
from slam_gym.types import NO_ID, SPURIOUS, UNLABELLED, UNPAIRED, Array, BoolArray, IntArray, Odometry, Truth

FOLDER = "runs"  # with these files, in the folder of an evaluation
MAX_GAP = 1.0  # [s] poses are not interpolated between samples that are farther apart …
LONG = 3.0  # … and more than so many times the median distance
DEVIANT = 1.3  # D² of pairings over its degrees of freedom: 1.5 to 1.9 where the sigmas are two thirds of the true ones
_FEWEST = 3  # instants that are compared: a rigid motion lays two anywhere
_LEAST_NOISE = 1e-12 * np.eye(3)  # added to the covariance of a motion, which may be zero while the robot rests
REFERENCE_SIGMA = (0.005, 0.005, math.radians(0.5))  # [m, m, rad] of reference poses


class Comparison(NamedTuple):
    """Poses of the map and of the reference at the same instants."""

    times: Array  # (k,) [s]
    estimated: Array  # (k, 3) [m, m, rad] in B, the frame of the map
    reference: Array  # (k, 3) [m, m, rad] in W, the frame of the reference

    @property
    def alignment(self) -> Array:
        """(3,) the rigid transformation that aligns the estimate with the reference."""
        return align_se2(self.estimated[:, :2], self.reference[:, :2])

    def frame(self) -> pd.DataFrame:
        """A row for each instant: time [s], aligned estimated position, reference, and their distance [m]."""
        moved, true = transform(self.alignment, np.ascontiguousarray(self.estimated[:, :2])), self.reference[:, :2]
        rows = np.column_stack([self.times, moved, true, np.hypot(*(moved - true).T)])
        return pd.DataFrame(rows, columns=["time", "x", "y", "reference_x", "reference_y", "error"])


def compare(log: Recording, poses: Array) -> Comparison:
    """Poses (T, 3) of a log's steps beside its reference, at common instants: of the two, the one with more samples
    during the log is interpolated at the samples of the other."""
    t, reference = log.reference_times, log.reference_poses
    during = _during(log)
    if during.sum() <= len(log):
        rows = during & _close(log.times, t)
        return Comparison(t[rows], interpolate(log.times, poses, t[rows]), reference[rows])
    rows = _close(t, log.times)
    return Comparison(log.times[rows], poses[rows], interpolate(t, reference, log.times[rows]))


def _during(log: Recording) -> BoolArray:
    """(G,) whether each pose of the reference lies within the times of the log."""
    return np.asarray((log.reference_times >= log.times[0]) & (log.reference_times <= log.times[-1]))


def _close(times: Array, instants: Array) -> BoolArray:
    """(k,) whether each of `instants` (k,) lies between two of `times` that are no farther apart than 1 s or, of
    more than three, `LONG` times their median distance."""
    longest = max(MAX_GAP, LONG * float(np.median(np.diff(times)))) if len(times) > _FEWEST else MAX_GAP
    padded = np.concatenate([[-np.inf], times, [np.inf]])
    before, after = np.searchsorted(times, instants, side="right"), np.searchsorted(times, instants) + 1
    return padded[after] - padded[before] <= longest


@dataclass(frozen=True)
class MappedLog:
    """The result of mapping a log of T steps and M measurements, in B, the frame of the map."""

    log: Recording
    slam: Slam  # after the last step
    doubted: int  # scans that were doubted
    deviation: float  # D² of all pairings over its degrees of freedom (at least 40), about 1 where sigmas are right
    poses: Array  # (T, 3) [m, m, rad]
    pose_covariances: Array  # (T, 3, 3) [m², m·rad, rad²]
    in_base: BoolArray  # (T,) whether the covariance is in B: the base of a second map has an error of its own
    measurements: pd.DataFrame  # M rows: source; whether paired; final id of the feature, and its source
    features: pd.DataFrame  # of the final map, oldest first: the columns of its file except the aligned position
    tally: Tally
    effort: Record  # of the associator, and of the steps
    in_world: bool  # B is the frame W of the reference, since the reference gives the pose at the log's start


def map_log(
    log: Recording, associator: str, spec: SlamSpec, relocation: str | None = None, *, in_world: bool = True
) -> MappedLog:
    """Map a log with an associator; `relocation` is the search that relocates a lost robot, None: no search, no atlas.

    The frame of the map is that of the reference, where it gives the pose at the start and `in_world` is true.
    With `true_association`, the map uses the identities as well: every labelled feature is added when it is first seen,
    without confirmation, and no other feature is. The remaining error is not caused by associations, and the robot is
    never lost. Raises as `Slam.step` does, and ValueError for an unknown search.
    """
    informed = associator == CEILING
    if informed:
        spec, relocation = replace(spec, map=replace(spec.map, confirmations=1)), None
    search = None if relocation is None else relocate_by(relocation)
    slam = Slam(spec, relocate=search, atlas=search and AtlasSpec())
    start = start_of(log) if in_world else None
    if start is not None:
        slam.map.place(start, np.zeros((3, 3)))
    meter, associate = metered(associator)
    judged = JudgedSlam(slam, associate, informed=informed)
    steps = []
    for odometry, scan, sources in log.steps():
        began = time.perf_counter()
        step = judged.step(odometry, scan, Truth(slam.map.pose, sources))
        seconds = time.perf_counter() - began
        doubted = slam.doubted and len(scan) > 0
        fit = step.hypothesis.joint_distance, step.hypothesis.dof
        is_base = len(slam.maps) == 1 and not (slam.atlas is not None and slam.atlas.has_dropped)
        pose = slam.map.pose, slam.map.pose_covariance, is_base
        steps.append((*pose, step.ids, step.created, doubted, fit, seconds))
    poses, covariances, in_base, ids, created, doubts, fits, times = zip(*steps)
    feature, identities, m = np.concatenate(ids), judged.identities, slam.map
    measurements = pd.DataFrame({
        "source": log.sources,
        "paired": (feature != NO_ID) & ~np.concatenate(created),
        "feature": final_ids(slam, feature),
        "feature_source": np.where(feature == NO_ID, UNPAIRED, identities.majority_of(np.maximum(feature, 0))),
    })  # fmt: skip
    features = pd.DataFrame({
        "id": m.ids, "identity": identities.majority_of(m.ids), "confirmed": (~m.provisional).astype(int),
        "seen": m.seen, "x": m.positions[:, 0], "y": m.positions[:, 1], "variance_x": m.covariances[:, 0, 0],
        "covariance_xy": m.covariances[:, 0, 1], "variance_y": m.covariances[:, 1, 1], "size": m.sizes,
    })  # fmt: skip
    effort = meter.effort() | {"seconds": sum(times), "step_microseconds": 1e6 * float(np.median(times))}
    distance, dof = np.sum(fits, axis=0)
    run = slam, sum(doubts), float(distance / max(dof, 40)), np.array(poses), np.array(covariances), np.array(in_base)
    return MappedLog(log, *run, measurements, features, identities.total, effort, start is not None)


def final_ids(slam: Slam, ids: IntArray) -> IntArray:
    """The present ids of features with the ids (k,), after all later fusions; NO_ID remains."""
    final = ids.copy()
    for record in slam.atlas.fusions if slam.atlas is not None else ():
        for remaining, removed in record.ids.tolist():
            final[final == removed] = remaining
    return final


def smoothed(mapped: MappedLog) -> MappedLog | None:
    """The batch least-squares solution, in poses and map, for the same pairings, started at the poses of the filter.

    None where there are no pairings, the iterations run out, or a covariance of a measurement is not positive definite.
    """
    motions, scans, _ = zip(*mapped.log.steps())
    odometry = [Odometry(u.motion, u.covariance + _LEAST_NOISE) for u in motions]
    pairings = np.split(mapped.measurements["feature"].to_numpy(), mapped.log.starts[1:-1])
    try:
        best = smooth(odometry, scans, pairings, mapped.poses)
    except ValueError:
        return None
    x, y = best.positions[np.searchsorted(best.ids, mapped.features["id"])].T
    return replace(mapped, poses=best.poses, features=mapped.features.assign(x=x, y=y), in_world=False)


def start_of(log: Recording) -> Array | None:
    """The pose (3,) in W at which the first motion starts, or None where the reference does not contain it."""
    if not len(log.reference_times) or not log.reference_times[0] <= log.times[0] <= log.reference_times[-1]:
        return None
    first = interpolate(log.reference_times, log.reference_poses, log.times[:1])[0]
    return compose(first, inverse(log.motions[0])) if np.isfinite(first[2]) else None


# -- measures --------------------------------------------------------------------------------------------------------


def measure(mapped: MappedLog) -> Record:
    """All measures of a mapped log."""
    log = mapped.log
    about = {"steps": len(log), "measurements": len(log.points), "missed_loop": mapped.slam.missed_loop}
    about |= {"deviation": mapped.deviation}
    errors, best = _poses(mapped) | _landmarks(mapped), smoothed(mapped)
    of_best = {} if best is None else _poses(best) | _landmarks(best)
    batch = {f"{name}_batch": of_best.get(name, math.nan) for name in ("ate", "landmark_rmse")}
    return about | associations(mapped) | errors | batch | mapped.effort


def associations(mapped: MappedLog) -> Record:
    """Measures of the pairings of measurements with an identity and, separately, of spurious ones; and of the confirmed
    features, by the identity of most of their measurements (NaN without labels)."""
    tally, sources = replace(mapped.tally, fp_spurious=0), mapped.log.sources
    spurious = mapped.measurements[mapped.measurements["source"] == SPURIOUS]
    accepted = spurious[spurious["paired"]]
    identity = mapped.features.loc[mapped.features["confirmed"] > 0, "identity"]
    found, labelled = identity[identity >= 0].nunique(), (sources != UNLABELLED).any()
    return {
        "precision": tally.precision,
        "recall": tally.recall,
        "f1": tally.f1,
        "wrong": tally.fp_wrong,
        "clutter": len(spurious),
        "clutter_accepted": len(accepted),
        "clutter_share": float(spurious["paired"].mean()),
        "clutter_on_landmarks": int((accepted["feature_source"] >= 0).sum()),
        "features": len(identity),
        "true_features": len(np.unique(sources[sources >= 0])),
        "found": found,
        "duplicates": int((identity >= 0).sum()) - found if labelled else math.nan,
        "clutter_features": int((identity == SPURIOUS).sum()) if labelled else math.nan,
    }


def _poses(mapped: MappedLog) -> Record:
    """Errors of the positions; errors without alignment and ANEES only where B is the frame of the reference. ANEES is
    over the steps in B for which there is a reference, and includes the uncertainty of the reference. NaN where fewer
    than three instants can be compared."""
    log, compared = mapped.log, compare(mapped.log, mapped.poses)
    if len(compared.times) < _FEWEST:
        return dict.fromkeys(("ate", "ate_median", "ate_unaligned", "anees"), math.nan)
    aligned = {
        "ate": ate(compared.estimated, compared.reference, aligned=True),
        "ate_median": float(compared.frame()["error"].median()),
    }
    if not mapped.in_world:
        return aligned | {"ate_unaligned": math.nan, "anees": math.nan}
    known = _close(log.reference_times, log.times) & mapped.in_base
    true = interpolate(log.reference_times, log.reference_poses, log.times[known])
    covariances = mapped.pose_covariances[known] + np.diag(np.square(REFERENCE_SIGMA))
    values = [pose_nees(*arrays) for arrays in zip(mapped.poses[known], covariances, true)]
    return aligned | {"ate_unaligned": ate(compared.estimated, compared.reference), "anees": anees(np.array(values), 3)}


def _landmarks(mapped: MappedLog) -> Record:
    """Errors of the landmarks with known positions; of duplicates, the oldest counts."""
    places = pd.DataFrame(mapped.log.landmarks, mapped.log.landmark_ids, ["true_x", "true_y"])
    confirmed = mapped.features[mapped.features["confirmed"] > 0].drop_duplicates("identity")
    both = confirmed.merge(places, left_on="identity", right_index=True)
    estimated, true = both[["x", "y"]].to_numpy(), both[["true_x", "true_y"]].to_numpy()
    return {
        "landmark_rmse": landmark_rmse(estimated, true, aligned=True),
        "landmark_rmse_unaligned": landmark_rmse(estimated, true) if mapped.in_world else math.nan,
        "landmarks_compared": len(both) if len(places) else math.nan,
    }


# -- files -----------------------------------------------------------------------------------------------------------


def write_mapped_log(folder: Path, associator: str, mapped: MappedLog) -> None:
    """Write all files of a log that was mapped with an associator."""
    log, base = mapped.log, stem(mapped.log.name, associator)
    folder.mkdir(parents=True, exist_ok=True)
    known = np.isfinite(log.reference_poses[:, 2])
    if known.any():
        write_tum(folder / f"{stem(log.name)}.reference.tum", log.reference_times[known], log.reference_poses[known])
    write_tum(folder / f"{base}.tum", log.times, mapped.poses)
    compared, features = compare(log, mapped.poses), mapped.features
    during = _during(log)
    aligned = transform(compared.alignment, np.ascontiguousarray(features[["x", "y"]].to_numpy()))
    frames = {
        f"{stem(log.name)}.reference.csv": pd.DataFrame(log.reference_poses[during, :2], columns=["x", "y"]),
        f"{stem(log.name)}.landmarks.csv": pd.DataFrame(log.landmarks, columns=["x", "y"]),
        f"{base}.map.csv": features.assign(aligned_x=aligned[:, 0], aligned_y=aligned[:, 1]),
        f"{base}.errors.csv": compared.frame(),
    }
    for name, frame in frames.items():
        write_whole(folder / name, frame.to_csv(index=False, float_format="%.9g"))


# -- the evaluation ---------------------------------------------------------------------------------------------------


def logs_of(options: Recorded, recording: str) -> list[Recording]:
    """All logs of a recording, prepared for mapping by the options.

    Raises as `open_recordings` does, and ValueError for an option that is for other recordings, and for a reference of
    another time than the log.
    """
    if options.robots and recording != "mrclam":
        raise ValueError(f"--robots is for mrclam, not for {recording}")
    if options.reference and not recording.lower().endswith(".g2o"):
        raise ValueError(f"--reference is for .g2o files, not for {recording}")
    if options.data and recording not in PUBLISHED:
        raise ValueError(f"--data is for {', '.join(PUBLISHED)}, not for {recording}")
    logs = open_recordings(recording, options.data, options.robots, reference=options.reference)
    for log in logs:
        if len(log.reference_times) and not _during(log).any():
            raise ValueError(f"{log.name}: the reference lies outside the times of the log; is its clock another one?")
    return [surveyed(log.every(options.every) if options.every > 1 else log) for log in logs]


def surveyed(log: Recording) -> Recording:
    """The log with the batch solution for its identities as its landmarks and reference, where it has none.

    Maps are then compared with the best map that the log allows.
    """
    if len(log.landmarks) or not (log.sources >= 0).any():
        return log
    best = smoothed(map_log(log, CEILING, slam_for(log)))
    if best is None:
        return log
    known = best.features[best.features["identity"] >= 0]
    ids, places = known["identity"].to_numpy(), np.ascontiguousarray(known[["x", "y"]].to_numpy())
    reference = "It has no survey: maps are compared with batch least squares with its identities."
    source = f"{log.source.rstrip('.')}. {reference}"
    log = replace(log, landmark_ids=ids, landmarks=places, source=source)
    if len(log.reference_times):
        return log
    return replace(log, reference_times=log.times, reference_poses=best.poses * [1.0, 1.0, math.nan])


def map_and_measure(log: Recording, name: str, associator: str, relocation: str | None, folder: Path) -> list[Record]:
    """Map one log with an associator and a relocation search, and write trajectory and map to a folder."""
    mapped = map_log(log, associator, slam_for(log), relocation)
    write_mapped_log(folder, name, mapped)
    return [{"source": log.source} | measure(mapped)]


def recording_evaluation(
    associators: Sequence[str],
    logs: Sequence[Recording],
    conditions: dict[str, Any],
    out: Path,
    relocations: Sequence[str | None],
) -> Evaluation:
    """The evaluation of every associator with every relocation on every log; files go to a folder in `out`.

    Raises ValueError for an unknown associator or relocator.
    """
    tasks = [
        Task([Key(name, log.name, 0)], partial(map_and_measure, log, name, *searches, out / FOLDER))
        for log in logs
        for name, searches in contenders(associators, relocations).items()
        if searches[0] != CEILING or (log.sources != UNLABELLED).any()  # without labels it pairs nothing
    ]
    if not tasks:
        raise ValueError(f"{CEILING} needs identities, and no measurement has one")
    about = {
        "settings": {log.name: asdict(slam_for(log)) for log in logs},
        "models": hashes_of(*associators, *relocations, conditions["recording"]),
    }
    return Evaluation("recordings", tasks, conditions | {"relocation": list(relocations)}, about)
