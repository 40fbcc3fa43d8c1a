"""Corners in hollows: places among solids whose hidden faces were never made, lit as the rest of their faces.

A floor's corner reaches under a pillar, which has no bottom: it does not lie inside a closed solid, for a little light
finds its way there, but nobody sees it, and its faces would be shaded black towards it. So a corner on a border that is
darker than another at the other end of one of its edges, and that sees its surroundings mostly from behind, takes
the mean light of the part of its faces that lies in the open, if that is the larger part, as corners do that a wall
cuts off (`walled_off`). A hollow need be no higher than a plinth, over which those look.

Either sign alone is common in the open: contacts are dark, and what lies under a sheet sees its back. A dark room drawn
with its walls outward stays dark: its floor may reach out into daylight, but most of that floor is in the room then.
Cost: `RAYS` for each dark corner, and for each sample of the faces of those in a hollow.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence

import numpy as np

from ..light_groups import level
from ..progress import shared_progress
from ..scene import ReceiverMesh
from ..solvers.patch_solution import PatchSolution
from ..visibility.embree import OFFSET
from .ears import around_corners, ears, lattice
from .looks import look
from .receivers import Receivers
from .snapping import own_surface

#: Part of the light at the other end of an edge, and of that on its faces in the open, below which a corner is dark. A
#: black wall beside it leaves half.
DARK = 0.45

#: Part of the view that is surfaces from behind, from which on a dark place is in a hollow. At its edge it is half, but
#: for a ray's breadth.
BACKS = 0.45

#: Part of a corner's ears, weighted by its share of them, that must lie in the open.
MOST = 0.5

#: Height above and below a face within which its surface is found, in sizes of the faces around.
REACH = 0.01

#: Rays over the hemisphere, and to each light at most.
RAYS = 64
PENUMBRA_RAYS = 16


def light_hollows(
    solution: PatchSolution,
    meshes: Sequence[ReceiverMesh],
    receivers: Receivers,
    light: np.ndarray,
    settled: np.ndarray,
    penumbra_rays: int,
    seed: int,
) -> Generator[float, None, tuple[np.ndarray, int]]:
    """Give receivers in hollows the light (r, 2 c), direct and indirect, of the rest of their faces; which ones (r,)
    bool were given it, and the rays it took. The array given is changed.

    Parameters
    ----------
    meshes : sequence of ReceiverMesh
        Those that `receivers` are of, with or without geometry.
    settled : (r,) bool
        Receivers whose light is that of another place already: they are neither asked nor compared with.
    """
    moved = np.zeros(len(receivers), bool)
    asked = _darker(receivers, level(light), settled)
    if not len(asked):
        return moved, 0
    work = look(solution, receivers.points[asked], receivers.normals[asked], asked, RAYS, 1, seed)
    here = yield from shared_progress(work, 0.0, 0.4)
    asked = asked[here.backs > BACKS]
    owners, points, weights = _samples(solution, meshes, receivers, asked)
    normals = receivers.normals[asked[owners]]
    rays = min(penumbra_rays, PENUMBRA_RAYS)
    work = look(solution, points, normals, np.arange(len(points)), RAYS, rays, seed)
    seen = yield from shared_progress(work, 0.4, 1.0)
    own, found = level(light[asked])[owners], level(seen.light)
    is_open = seen.free & (seen.backs < BACKS) & (own < DARK * found)

    def sums(of: np.ndarray) -> np.ndarray:
        return np.bincount(owners, weights=of, minlength=len(asked))

    # What lies inside solids is in no picture.
    given = np.flatnonzero(sums(weights * is_open) > MOST * sums(weights * seen.free))
    total = np.stack([sums(weights * is_open * seen.light[:, k]) for k in range(light.shape[1])], axis=1)
    light[asked[given]] = total[given] / sums(weights * is_open)[given, None]
    moved[asked[given]] = True
    return moved, here.rays + seen.rays


def _darker(receivers: Receivers, brightness: np.ndarray, settled: np.ndarray) -> np.ndarray:
    """(n,) receivers on borders darker by far than the other end of one of their edges."""
    brightest = np.zeros(len(brightness), brightness.dtype)
    for one, other in (receivers.edges.T, receivers.edges.T[::-1]):
        np.maximum.at(brightest, one, np.where(settled[other], 0, brightness[other]))
    return np.flatnonzero(receivers.borders & ~settled & (brightness < DARK * brightest))


def _samples(solution: PatchSolution, meshes: Sequence[ReceiverMesh], receivers: Receivers, asked: np.ndarray):
    """Samples of the ears of receivers `asked` (n,), where their surface is: rows of `asked` (s,), points (s, 3), and
    weights (s,)."""
    samples, shares = lattice()
    row = np.full(len(receivers), -1)
    row[asked] = np.arange(len(asked))
    found = [(np.empty(0, np.int64), np.empty((0, 3), np.float32), np.empty(0))]
    for mesh, who in zip(meshes, receivers.corner_receivers, strict=True):
        corners = np.flatnonzero((who >= 0) & (row[who] >= 0))
        around = who[around_corners(mesh, corners, receivers.points[who])]
        around = around[(around >= 0).all(axis=1)]
        places = receivers.points[around].astype(np.float64)
        sides, areas, sound = ears(places, receivers.normals[around[:, 0]], mesh.flipped)
        points = (places[sound, :1] + samples @ sides[sound]).reshape(-1, 3).astype(np.float32)
        weights = (areas[sound, None] * shares).ravel()
        found.append((np.repeat(row[around[sound, 0]], len(shares)), points, weights))
    owners, points, weights = (np.concatenate(parts) for parts in zip(*found, strict=True))
    normals = receivers.normals[asked[owners]]
    reach = np.float32(REACH) * receivers.sizes[asked[owners], None] + np.float32(4 * OFFSET)
    # An ear of a face with more corners may hang over where the face is not.
    there = own_surface(solution.tracer, points + reach * normals, -reach * normals, normals, solution.pool)[0]
    return owners[there], points[there], weights[there]
