"""Corners in hollows: places among solids whose hidden faces were never made, lit as the rest of their faces.

A floor's corner reaches under a pillar, which has no bottom: it does not lie inside a closed solid, for a little light
finds its way there, but nobody sees it, and its faces would be shaded black towards it. So a corner on a border that is
darker than another at the other end of one of its edges, and that sees its surroundings mostly from behind, takes
the mean light of the part of its faces that lies in the open, if that is the larger part, as corners do that a wall
cuts off (`walled_off`). A hollow need be no higher than a plinth, over which those look.

A face of many corners is drawn as triangles, by each program as others. A corner whose triangles all lie in the hollow
may have others there, that reach far: it takes the light of the whole face, if nearly all of that is in the open.

Either sign alone is common in the open: contacts are dark, and what lies under a sheet sees its back. A dark room drawn
with its walls outward stays dark: its floor may reach out into daylight, but most of that floor is in the room then.
Cost: `RAYS` for each dark corner, and for each sample of the faces of those in a hollow.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence

import numpy as np

from ..light_groups import level
from ..progress import shared_progress
from ..scene import ReceiverMesh
from ..solvers.patch_solution import PatchSolution
from ..visibility.embree import OFFSET
from .ears import Places, around_corners, ears, lattice, whole_faces
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

#: Part of a face of many corners that must lie in the open, for a corner none of whose own triangles does; and the most
#: corners for which that is asked.
MOST_OF_FACE = 0.8
MANY = 32

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
    asked = _darker(meshes, receivers, level(light), settled)
    if not len(asked):
        return moved, 0
    work = look(solution, receivers.points[asked], receivers.normals[asked], asked, RAYS, 1, seed)
    here = yield from shared_progress(work, 0.0, 0.4)
    asked, rays = asked[here.backs > BACKS], here.rays
    for triangles, most, low, high in ((_own_ears, MOST, 0.4, 0.8), (_whole_faces, MOST_OF_FACE, 0.8, 1.0)):
        asked = asked[~moved[asked]]
        owners, points, weights = _samples(solution, meshes, receivers, asked, triangles)
        normals = receivers.normals[asked[owners]]
        shadow_rays = min(penumbra_rays, PENUMBRA_RAYS)
        work = look(solution, points, normals, np.arange(len(points)), RAYS, shadow_rays, seed)
        seen = yield from shared_progress(work, low, high)
        rays += seen.rays
        is_open = seen.free & (seen.backs < BACKS) & (level(light[asked])[owners] < DARK * level(seen.light))
        within, free = (_sums(owners, weights * of, len(asked)) for of in (is_open, seen.free))
        # What lies inside solids is in no picture.
        given = np.flatnonzero(within > most * free)
        weights = weights * is_open
        total = np.stack([_sums(owners, weights * column, len(asked)) for column in seen.light.T], axis=1)
        light[asked[given]] = total[given] / within[given, None]
        moved[asked[given]] = True
    return moved, rays


def _sums(owners: np.ndarray, values: np.ndarray, count: int) -> np.ndarray:
    # Of nothing NumPy counts in integers.
    return np.bincount(owners, weights=values, minlength=count).astype(np.float64, copy=False)


def _darker(meshes, receivers: Receivers, brightness: np.ndarray, settled: np.ndarray) -> np.ndarray:
    """(n,) receivers on borders darker by far than the other end of one of their edges, or than another corner of one
    of their faces that have many."""
    brightest = np.zeros(len(brightness), brightness.dtype)
    known = np.where(settled, 0, brightness)
    for one, other in (receivers.edges.T, receivers.edges.T[::-1]):
        np.maximum.at(brightest, one, known[other])
    for mesh, who in zip(meshes, receivers.corner_receivers, strict=True):
        counts = np.diff(mesh.face_offsets)
        if len(counts) and counts.max() > 4:
            corners = np.flatnonzero((who >= 0) & np.repeat(counts > 4, counts))
            faces = np.repeat(np.arange(len(counts)), counts)[corners]
            over = np.zeros(len(counts), brightness.dtype)
            np.maximum.at(over, faces, known[who[corners]])
            np.maximum.at(brightest, who[corners], over[faces])
    return np.flatnonzero(receivers.borders & ~settled & (brightness < DARK * brightest))


def _own_ears(mesh: ReceiverMesh, corners: np.ndarray, places: Places) -> tuple[np.ndarray, np.ndarray]:
    """Corner (n,) that each ear is of, and its corners (n, 3)."""
    around = around_corners(mesh, corners, places)
    return around[:, 0], around


def _whole_faces(mesh: ReceiverMesh, corners: np.ndarray, places: Places) -> tuple[np.ndarray, np.ndarray]:
    """Corner (n,) that each triangle of its face is for, and the triangle's corners (n, 3)."""
    owners, triangles = whole_faces(mesh, corners, places, MANY)
    return corners[owners], triangles


def _samples(solution: PatchSolution, meshes, receivers: Receivers, asked: np.ndarray, triangles: Callable):
    """Samples of the `triangles` of receivers `asked` (n,), where their surface is: rows of `asked` (s,), points
    (s, 3), and weights (s,)."""
    samples, shares = lattice()
    row = np.full(len(receivers), -1)
    row[asked] = np.arange(len(asked))
    found = [(np.empty(0, np.int64), np.empty((0, 3), np.float32), np.empty(0))]
    for mesh, who in zip(meshes, receivers.corner_receivers, strict=True):
        corners = np.flatnonzero((who >= 0) & (row[who] >= 0))
        owners, around = triangles(mesh, corners, lambda corners, who=who: receivers.points[who[corners]])
        around, owners = who[around], who[owners]
        usable = (around >= 0).all(axis=1)
        around, owners = around[usable], owners[usable]
        places = receivers.points[around].astype(np.float64)
        sides, areas, sound = ears(places, receivers.normals[owners], mesh.flipped)
        points = (places[sound, :1] + samples @ sides[sound]).reshape(-1, 3).astype(np.float32)
        weights = (areas[sound, None] * shares).ravel()
        found.append((np.repeat(row[owners[sound]], len(shares)), points, weights))
    owners, points, weights = (np.concatenate(parts) for parts in zip(*found, strict=True))
    normals = receivers.normals[asked[owners]]
    reach = np.float32(REACH) * receivers.sizes[asked[owners], None] + np.float32(4 * OFFSET)
    # An ear of a face with four corners may hang over where the face is not.
    there = own_surface(solution.tracer, points + reach * normals, -reach * normals, normals, solution.pool)[0]
    return owners[there], points[there], weights[there]
