"""Faces inside solids of meshes that modifiers reshape: lit as the faces around them.

Nobody sees a face between two boxes that were pushed into each other, and it is black for good reason. But a bevel
makes new faces, and gives them the colors of any face at their edge, that one too: a black strip on a white pillar. A
mean per vertex takes it in as well. So such a face's corner takes the mean of the other faces at its vertex.

It is told by two things together: it is much darker than the other faces at its vertex, and most of what it sees it
sees from behind. Either alone is common in the open: the shaded side of a box, a floor under a sheet. Cost: `RAYS`
for each corner much darker than others at its vertex. Other meshes keep what they have: what is not seen does no harm
there.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence

import numpy as np

from ..keys import row_keys
from ..light_groups import BANDS
from ..scene import ReceiverMesh
from ..solvers.patch_solution import BURIED, PatchSolution
from .looks import look
from .receivers import Receivers

#: Part of the mean light of the other faces at its vertex below which a corner is looked at.
DIM = 0.05

#: Rays over the hemisphere, and to each light: the light itself is not used.
RAYS = 64


def cover_inner_faces(
    solution: PatchSolution, meshes: Sequence[ReceiverMesh], receivers: Receivers, light: np.ndarray, seed: int
) -> Generator[float, None, tuple[np.ndarray, int]]:
    """Give receivers of inner faces the mean light of the others at their vertices; which ones (r,) bool, and the rays
    it took. The array (r, 2 c) given is changed.

    Parameters
    ----------
    meshes : sequence of ReceiverMesh
        Those that `receivers` are of, with or without geometry. Only those off their surface are looked at.
    """
    inner = np.zeros(len(receivers), bool)
    vertices, who = _at_vertices(meshes, receivers)
    level = light[:, : 2 * BANDS].sum(axis=1, dtype=np.float64)
    others = np.bincount(vertices, minlength=1)[vertices] - 1
    around = np.bincount(vertices, weights=level[who], minlength=1)[vertices] - level[who]
    asked = np.unique(who[(others > 0) & (level[who] * others < DIM * around)])
    if not len(asked):
        return inner, 0
    seen = yield from look(solution, receivers.points[asked], receivers.normals[asked], asked, RAYS, 1, seed)
    inner[asked[seen.backs > BURIED]] = True
    lit = ~inner[who]
    shares = np.bincount(vertices[lit], minlength=vertices.max() + 1)
    columns = range(light.shape[1])
    sums = [np.bincount(vertices[lit], weights=light[who[lit], k], minlength=len(shares)) for k in columns]
    means = np.stack(sums, axis=1) / np.maximum(shares, 1)[:, None]
    given = ~lit & (shares[vertices] > 0)
    counts = np.bincount(who[given], minlength=len(light))
    reached = counts > 0
    for k in columns:
        totals = np.bincount(who[given], weights=means[vertices[given], k], minlength=len(light))
        light[reached, k] = totals[reached] / counts[reached]
    return inner, seen.rays


def _at_vertices(meshes: Sequence[ReceiverMesh], receivers: Receivers) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (n,), numbered through all meshes, and receivers (n,) that are at them, each pair once."""
    vertices, who, base = [np.empty(0, np.int64)], [np.empty(0, np.int64)], 0
    for mesh, corners in zip(meshes, receivers.corner_receivers, strict=True):
        if not mesh.is_off_surface or not len(corners):
            continue
        sound = np.flatnonzero(corners >= 0)
        _, first = np.unique(row_keys(mesh.corner_vertices[sound], corners[sound]), return_index=True)
        kept = np.sort(sound[first])
        vertices.append(mesh.corner_vertices[kept].astype(np.int64) + base)
        who.append(corners[kept].astype(np.int64))
        base += int(mesh.corner_vertices.max()) + 1
    return np.concatenate(vertices), np.concatenate(who)
