"""What the learned associator is trained on: the hypotheses that the search keeps of a scan, and what in them is
right."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slam_gym.association.learned.inputs import inputs_of
from slam_gym.association.tracking.headings import headings
from slam_gym.association.tracking.marginals import marginals
from slam_gym.association.tree import Tree
from slam_gym.simulation.right_answers import RightAnswers
from slam_gym.types import UNLABELLED, UNPAIRED, Array, BoolArray, IntArray, Prediction, Scan

WIDTH, MARGIN = 150, 16.0  # of the search: wider than that which decides, for it is still to learn
_MOST = 80  # hypotheses of a scan that are kept


class Decisions(NamedTuple):
    """One scan: c pairings, b hypotheses, m measurements."""

    inputs: NDArray[np.float32]  # (c, inputs)
    measured: NDArray[np.int32]  # (c,)
    slots: NDArray[np.int32]  # (c,) feature, one number for each in each part of the heading
    right: BoolArray  # (c,) the pairing is right
    hypotheses: NDArray[np.int32]  # (b, m) pairing of each measurement, or UNPAIRED
    scores: NDArray[np.float32]  # (b,) log densities of the model alone
    unpaired: BoolArray  # (m,) that is right
    known: BoolArray  # (m,) somebody knows what is right, and it is on offer
    weight: float  # what the scan counts


class _Watched:
    """Stands in for the network: keeps a tree and the numbers of its pairings, and adds nothing to them."""

    def __call__(self, tree: Tree, visibility: Array | None) -> Array:
        self.tree, self.inputs = tree, inputs_of(tree, visibility)
        return np.zeros(len(self.inputs))


class _Part(NamedTuple):
    watched: _Watched
    hypotheses: IntArray  # (b, m)
    scores: Array  # (b,)


def decisions_of(scan: Scan, prediction: Prediction, truth: RightAnswers) -> Decisions | None:
    """The decisions of a scan, or None where nothing is to be decided, or nobody knows what is right."""
    parts, pairings = [], 0
    for heading in headings(prediction):
        part = _searched(scan, heading.prediction, heading.log_weight, pairings)
        pairings += len(part.watched.inputs)
        parts.append(part)
    if not pairings:
        return None
    scores = np.concatenate([p.scores for p in parts])
    hypotheses = np.concatenate([p.hypotheses for p in parts])
    best = np.argsort(-scores, kind="stable")[:_MOST]
    best = best[scores[best] > scores[best[0]] - MARGIN]
    measured = np.concatenate([p.watched.tree.pairings.measured for p in parts])
    rows = np.concatenate([p.watched.tree.rows[p.watched.tree.pairings.slots] for p in parts])
    offset = np.repeat(np.arange(len(parts)), [len(p.watched.inputs) for p in parts]) * (len(prediction) + 1)
    right, unpaired, known = labels(truth, prediction, measured, rows)
    if not known.any():
        return None
    return Decisions(
        np.concatenate([p.watched.inputs for p in parts]).astype(np.float32),
        measured.astype(np.int32), (rows + offset).astype(np.int32), right, hypotheses[best].astype(np.int32),
        scores[best].astype(np.float32), unpaired, known, 1.0,
    )  # fmt: skip


def _searched(scan: Scan, prediction: Prediction, log_weight: float, offset: int) -> _Part:
    """The search in one narrow heading; its pairings are numbered from `offset` on."""
    watched = _Watched()
    found = marginals(scan, prediction, width=WIDTH, margin=MARGIN, learned=watched)
    pairings, rows = watched.tree.pairings, watched.tree.rows
    number = np.full((len(scan), len(prediction) + 1), UNPAIRED)
    number[pairings.measured, rows[pairings.slots]] = np.arange(len(pairings.slots))
    own = number[np.arange(len(scan)), found.hypotheses]  # row UNPAIRED is the last column
    scores = found.log_densities + log_weight
    return _Part(watched, np.where(own == UNPAIRED, UNPAIRED, own + offset), scores)


def labels(
    truth: RightAnswers, prediction: Prediction, measured: IntArray, rows: IntArray
) -> tuple[BoolArray, BoolArray, BoolArray]:
    """Which pairings (c,) are right, duplicates included; which measurements (m,) are of nothing in the map; and of
    which of them that is known, and on offer."""
    identities = np.append(truth.identities, UNLABELLED - 1)
    sources = truth.sources
    right = (identities[prediction.features[rows]] == sources[measured]) & (sources[measured] >= 0)
    unpaired = (sources != UNLABELLED) & (truth.right == UNPAIRED)
    offered = np.zeros(len(sources), np.bool_)
    offered[measured[right]] = True
    return right, unpaired, (unpaired | offered) & (sources != UNLABELLED)


class Batch(NamedTuple):
    """Many scans, flat: every number of a pairing, hypothesis or measurement counts through all of them."""

    inputs: NDArray[np.float32]  # (C, inputs)
    measured: IntArray  # (C,)
    slots: IntArray  # (C,)
    scores: NDArray[np.float32]  # (H,)
    scan_of: IntArray  # (H,) scan of each hypothesis
    made: IntArray  # (p, 2) hypothesis and pairing: it makes it
    agreed: IntArray  # (r, 2) hypothesis and measurement: it decides it rightly
    known: IntArray  # (k,) measurements of which it is known
    weights: NDArray[np.float32]  # (k,) what each counts
    measurements: int


def flat(scans: list[Decisions]) -> Batch:
    """Some scans as one batch."""
    columns: dict[str, list[Any]] = {name: [] for name in Batch._fields[:-1]}
    pairings = hypotheses = measurements = slots = 0
    for number, d in enumerate(scans):
        b, m = d.hypotheses.shape
        at, who = np.nonzero(d.hypotheses != UNPAIRED)
        made = d.hypotheses[at, who]
        agreed = np.where(d.hypotheses == UNPAIRED, d.unpaired, np.append(d.right, False)[d.hypotheses])
        columns["inputs"].append(d.inputs)
        columns["measured"].append(d.measured + measurements)
        columns["slots"].append(d.slots + slots)
        columns["scores"].append(d.scores - d.scores.max())
        columns["scan_of"].append(np.full(b, number))
        columns["made"].append(np.column_stack([at + hypotheses, made + pairings]))
        columns["agreed"].append(np.argwhere(agreed & d.known) + np.array([hypotheses, measurements]))
        columns["known"].append(np.flatnonzero(d.known) + measurements)
        columns["weights"].append(np.full(int(d.known.sum()), d.weight / max(d.known.sum(), 1), np.float32))
        pairings, hypotheses = pairings + len(d.measured), hypotheses + b
        measurements, slots = measurements + m, slots + int(d.slots.max()) + 1
    return Batch(**{name: np.concatenate(found) for name, found in columns.items()}, measurements=measurements)
