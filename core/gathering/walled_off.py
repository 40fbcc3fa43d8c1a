"""Corners that a wall cuts off from most of their faces: lit as these are, and not as the place where they stand.

A wall of one quad reaches past the walls it meets, and its corners stand outdoors, in the next room or in the dark
between two leaves. Light is stored at corners and interpolated over the face, so that what a corner sees there would
glow, or darken, all over a wall in whose room it is not. Such a corner takes the mean light of the part of its faces
that it does not see. This is the area-weighted resampling of L. Kavan, A. W. Bargteil, P.-P. Sloan, "Least Squares
Vertex Baking" (2011), kept to where a vertex sample is worst; a mean and not a fit, so it never leaves the range of
what was sampled. (A plane fitted to the samples and followed to the corner was tried: over the faces of two real houses
it errs by 1 to 10 % more than the mean, for light falls from a window in no straight line.)

For a corner in the dark, places from which one sees far count for more than those in the gap where it stands: they are
the ones that are seen.
A smaller part is enough for a corner on the border of its mesh in the dark, where nobody looks, and of a strip that
pierces a wall, as the sides of a panel or a beam do, for a corner outdoors if the room is dark: an end of the strip too
dark outdoors is not noticed, one that glows in the room is.

Only corners on borders and those of faces with a side longer than a patch are looked at: in the middle of a fine mesh
a wall is no further off than a small face. Cost: 16 short rays per such corner, and `RAYS` for each sample behind a
wall.

Limits: a face that two rooms share about equally keeps the light of its corners, unless one room is dark and the mesh
ends there: those corners are lit like the other room.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass

import numpy as np

from ..light_groups import level
from ..scene import ReceiverMesh
from ..solvers.patch_solution import PatchSolution
from ..visibility.embree import CHUNK_RAYS, OFFSET, RayPool, Tracer
from .ears import around_corners, ears, lattice
from .looks import look
from .receivers import BLOCK, Receivers
from .snapping import own_surface

#: Part of a corner's ears, weighed by its share of them, that must lie behind a wall.
MOST = 0.5

#: The same where that is enough: for a corner on a border in the dark, and for one outdoors of a strip, a face narrower
#: than a patch but longer.
LEAST = 0.1

#: Part of a corner's view that is sky, from which on it is outdoors.
OUTDOORS = 0.1

#: Height above the face at which corner and samples look for each other, in sizes of the faces around the corner: what
#: is lower parts no rooms.
LIFT = 0.04

#: By what factor the corner's own light must differ from that behind the wall. A smaller difference is one that light
#: often makes over a face so large.
APART = 2.0

#: The same for a corner darker than what is behind the wall: where walls meet it is dim by nature, on the ceiling of a
#: Cornell box by a factor of 2.3.
DIMMER = 2.5

#: By what factor a room must be brighter than a corner in the dark, or darker than one outdoors, for less of it to do.
FAR_APART = 20.0

#: Part of the corner's own light below which what is behind the wall is no room, but a hollow that nobody sees.
HOLLOW = 1e-3

#: Part of the view of a sample darker than its corner that is surfaces from behind, from which on it is a hollow too.
BACKS = 0.25

#: Rays over the hemisphere of each sample, and to each light at most. A corner has a dozen samples or more.
RAYS = 64
PENUMBRA_RAYS = 16


@dataclass(frozen=True)
class WalledOff:
    """Samples behind the walls that cut corners off.

    Parameters
    ----------
    receivers : (k,) int
        Those that are cut off.
    totals : (k,) float
        Weight of all samples of their faces, in front of the wall and behind it.
    strips : (k,) bool
        Whether all their faces are narrower than a patch, and one is longer.
    borders : (k,) bool
        Whether they are on the border of their mesh.
    places, directions : (k, 3) float32
        Where they stand themselves, and their normals.
    owners : (s,) int
        Row of `receivers` that each sample belongs to.
    points, normals : (s, 3) float32
        Samples, and the normals of their receivers.
    weights : (s,) float
    """

    receivers: np.ndarray
    totals: np.ndarray
    strips: np.ndarray
    borders: np.ndarray
    places: np.ndarray
    directions: np.ndarray
    owners: np.ndarray
    points: np.ndarray
    normals: np.ndarray
    weights: np.ndarray

    def sums(self, values: np.ndarray) -> np.ndarray:
        """(k,) sums over the samples of each receiver of values (s,)."""
        # Of nothing NumPy counts in integers.
        return np.bincount(self.owners, weights=values, minlength=len(self.receivers)).astype(np.float64, copy=False)

    def only(self, samples: np.ndarray) -> WalledOff:
        """Without the samples that are not among these (s,) bool, and without receivers to which too few are left."""
        enough = self.sums(self.weights * samples) > np.where(self.strips | self.borders, LEAST, MOST) * self.totals
        samples = samples & enough[self.owners]
        return WalledOff(
            self.receivers[enough],
            self.totals[enough],
            self.strips[enough],
            self.borders[enough],
            self.places[enough],
            self.directions[enough],
            (np.cumsum(enough) - 1)[self.owners[samples]],
            self.points[samples],
            self.normals[samples],
            self.weights[samples],
        )


def find_walled_off(
    tracer: Tracer, meshes: Sequence[ReceiverMesh], receivers: Receivers, spacing: float, pool: RayPool
) -> WalledOff:
    """Receivers that a wall cuts off from most of their faces.

    Parameters
    ----------
    meshes : sequence of ReceiverMesh
        In the unit frame, those that `receivers` are of.
    spacing : float
        Length of a face's side, in unit lengths, from which on it is looked at: a patch's.
    """
    samples, shares = lattice()
    total, longest, widest = (np.zeros(len(receivers)) for _ in range(3))
    found = [(np.empty(0, np.int64), np.empty((0, 3), np.float32), np.empty(0))]
    for mesh, who in zip(meshes, receivers.corner_receivers, strict=True):
        for owners, places, sides, areas in _ears(mesh, who, receivers, spacing):
            lengths = np.linalg.norm(sides, axis=2).max(axis=1)
            np.maximum.at(longest, owners, lengths)
            np.maximum.at(widest, owners, 2 * areas / lengths)
            points = (places[:, None] + samples @ sides).reshape(-1, 3).astype(np.float32)
            weights = (areas[:, None] * shares).ravel()
            owners = np.repeat(owners, len(shares))
            total += np.bincount(owners, weights=weights, minlength=len(total))
            hidden = _hidden(tracer, receivers, owners, points, pool)
            found.append((owners[hidden], points[hidden], weights[hidden]))
    owners, points, weights = (np.concatenate(parts) for parts in zip(*found, strict=True))
    strips = (longest > spacing) & (widest < spacing)
    who = np.arange(len(receivers))
    walled = WalledOff(
        who,
        total,
        strips,
        receivers.borders,
        receivers.points,
        receivers.normals,
        owners,
        points,
        receivers.normals[owners],
        weights,
    )
    walled = walled.only(np.ones(len(owners), bool))
    reach = np.float32(LIFT) * receivers.sizes[walled.receivers[walled.owners], None] + np.float32(4 * OFFSET)
    ends = -reach * walled.normals
    # An ear of a face with more corners may hang over where the face is not.
    return walled.only(own_surface(tracer, walled.points - ends, ends, walled.normals, pool)[0])


def _ears(mesh: ReceiverMesh, who: np.ndarray, receivers: Receivers, spacing: float):
    """Blocks of the ears looked at, but those that reach inward: receivers (n,), places (n, 3), the two sides (n, 2, 3)
    and the areas (n,) between them."""

    def at(corners: np.ndarray) -> np.ndarray:
        return mesh.positions[mesh.corner_vertices[corners]]

    for start in range(0, len(who), BLOCK):
        corners = start + np.flatnonzero(who[start : start + BLOCK] >= 0)
        around = around_corners(mesh, corners, at, spacing)
        places, corners = at(around).astype(np.float64), around[:, 0]
        sides, areas, wanted = ears(places, receivers.normals[who[corners]], mesh.flipped)
        with np.errstate(invalid="ignore"):  # broken vertices are not finite, and no side to them is longer
            large = (np.einsum("nij,nij->ni", sides, sides) > spacing**2).any(axis=1)
        wanted &= large | receivers.borders[who[corners]]
        if wanted.any():
            yield who[corners[wanted]].astype(np.int64), places[wanted, 0], sides[wanted], areas[wanted]


def _hidden(tracer: Tracer, receivers: Receivers, owners: np.ndarray, points: np.ndarray, pool: RayPool) -> np.ndarray:
    """(n,) bool: points (n, 3) that their receivers (n,) do not see along the surface."""
    hidden = np.empty(len(points), bool)

    def work(start: int, stop: int) -> None:
        who = owners[start:stop]
        lift = np.float32(LIFT) * receivers.sizes[who] + np.float32(4 * OFFSET)
        begin = receivers.points[who] + lift[:, None] * receivers.normals[who]
        segments = points[start:stop] + lift[:, None] * receivers.normals[who] - begin
        hidden[start:stop] = tracer.visibility(begin, segments, 1.0) == 0

    pool.run(work, len(points), CHUNK_RAYS)
    return hidden


def relight_walled_off(
    solution: PatchSolution, walled: WalledOff, light: np.ndarray, buried: np.ndarray, penumbra_rays: int, seed: int
) -> Generator[float, None, tuple[np.ndarray, int]]:
    """Give receivers the light behind the wall where theirs (r, 2 c), direct and indirect, is another; which ones (r,)
    bool were given it, and the rays it took. The array given is changed. What is `buried` (r,) is left alone.
    """
    walled = walled.only(~buried[walled.receivers[walled.owners]])
    count, here = len(walled.owners), walled.receivers
    points = np.concatenate([walled.points, walled.places])
    normals = np.concatenate([walled.normals, walled.directions])
    work = look(solution, points, normals, np.arange(len(points)), RAYS, min(penumbra_rays, PENUMBRA_RAYS), seed)
    seen = yield from work
    arriving, free, outdoors = seen.light[:count], seen.free[:count], seen.outside >= OUTDOORS
    behind, own = level(arriving), level(light[here])[walled.owners]
    # A hollow among solids is as dark as a dark room, but shows them from behind: no side of the wall either.
    free = free & ~((seen.backs[:count] >= BACKS) & (own > APART * behind))
    darker = free & (own > APART * behind) & (behind > HOLLOW * own)
    brighter = free & (behind > DIMMER * own)
    # A strip is not to glow in a dark room.
    brighter &= ~(walled.strips[walled.owners] & outdoors[:count] & (own > HOLLOW * behind))
    lighting = brighter & (behind > FAR_APART * own)
    glowing = darker & (own > FAR_APART * behind)
    # Of the sky one sees infinitely far; beyond the scene's own size that makes no difference.
    openness = np.minimum(seen.distances, 1)
    weights = walled.weights * free * openness[:count]
    # In front of the wall it is as open as at the corner.
    totals = walled.sums(weights) + (walled.totals - walled.sums(walled.weights)) * openness[count:]
    areas = walled.weights * free
    # What lies inside solids is on neither side.
    open_areas = walled.totals - walled.sums(walled.weights - areas)
    outdoors = walled.strips & outdoors[count:]
    moved = np.zeros(len(light), bool)
    for samples, enough in (
        (brighter, walled.sums(areas * brighter) > MOST * open_areas),
        (lighting, walled.sums(weights * lighting) > MOST * totals),
        (darker, walled.sums(areas * darker) > MOST * open_areas),
        (lighting, walled.borders & (walled.sums(walled.weights * lighting) > LEAST * walled.totals)),
        (glowing, outdoors & (walled.sums(walled.weights * glowing) > LEAST * walled.totals)),
    ):
        given = np.flatnonzero(enough)
        sums = np.stack([walled.sums(weights * samples * arriving[:, k]) for k in range(light.shape[1])], axis=1)
        light[here[given]] = sums[given] / walled.sums(weights * samples)[given, None]
        moved[here[given]] = True
    return moved, seen.rays
