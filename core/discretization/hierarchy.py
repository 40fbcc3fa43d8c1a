"""Hierarchy of a scene's surfaces: surface, subsurface, patch, element, each divided in two (survey figure 14).

A *surface* is a polygon as given. Its *subsurfaces* are the parts that can be divided by binary subdivision: itself
where it is a triangle or a convex quadrilateral, its triangles else. These are halved until they are small enough to
act as light sources, *patches*, and patches are halved into *elements*, which only receive. Quadrilaterals are cut
through the middles of the two longer opposite sides, triangles from the middle of their longest side.

Cuts end at the middles of sides only. So whatever two neighbors do, their borders have vertices at the same places, bit
for bit, and neighbors are found by comparing numbers. A hierarchy is *balanced* when no side of an element has more
than one vertex of others on it: neighbors differ by one halving of their common side. `conforming` makes triangles of
it that leave no gaps.

Cost: O(nodes log nodes); all nodes of a level are divided at once. Limits: surfaces are neighbors where they have a
whole side in common, or halves of it; corners that surfaces have on each other's sides anywhere else stay as they are.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..environment import Environment
from ..errors import SceneTooLargeError, SettingsError

#: Cosine above which surfaces face alike: a thousandth of a radian.
COPLANAR = 1 - 5e-7

#: Sizes are in these parts of the scene's longest side, as in Blender's old Radiosity tool.
UNITS = 2000


@dataclass(frozen=True)
class SubdivisionLimits:
    """Sizes of patches and elements, with the names and units of Blender's old Radiosity tool.

    A size v stands for the area of a square of side v / 2000 of the scene's longest side: 500 is a quarter of it.

    Attributes
    ----------
    patch_max : float
        PaMax: larger patches are halved.
    patch_min : float
        PaMin: no patch is made smaller than this.
    element_max : float
        ElMax: larger elements are halved.
    element_min : float
        ElMin: no element is made smaller than this.
    max_elements : int
        MaxEl: elements at most.
    """

    patch_max: float = 500
    patch_min: float = 200
    element_max: float = 100
    element_min: float = 20
    max_elements: int = 10_000

    def __post_init__(self):
        for name in ("patch_max", "patch_min", "element_max", "element_min"):
            if not getattr(self, name) > 0:
                raise SettingsError(f"Size {name} must be above 0, not {getattr(self, name)}")
        if self.max_elements < 1:
            raise SettingsError(f"Number max_elements must be 1 or more, not {self.max_elements}")


@dataclass(frozen=True)
class Hierarchy:
    """Binary forest of nodes; made by `build`, refined by `split`. Arrays have a row per node, parents before children.

    Attributes
    ----------
    environment : Environment
        The surfaces.
    limits : SubdivisionLimits
    corners : (m, 4, 3) float64
        Corners, counter-clockwise; triangles repeat their last.
    areas : (m,) float64
        Of one side.
    surfaces, parents : (m,) int64
        Polygon of each node; parent, -1 for subsurfaces.
    children : (m, 2) int64
        -1 for elements.
    patch_nodes : (p,) int64
        Nodes that are patches.
    patches : (m,) int64
        Patch that each node is part of, -1 above patches.
    """

    environment: Environment
    limits: SubdivisionLimits
    corners: np.ndarray
    areas: np.ndarray
    surfaces: np.ndarray
    parents: np.ndarray
    children: np.ndarray
    patch_nodes: np.ndarray
    patches: np.ndarray

    @classmethod
    def build(cls, environment: Environment, limits: SubdivisionLimits | None = None) -> Hierarchy:
        """Divide all surfaces that have an area until patches and elements are no larger than the limits.

        Raises
        ------
        SceneTooLargeError
            If the subsurfaces alone, or the patches that the limits ask for, are more than `max_elements`.
        """
        limits = limits or SubdivisionLimits()
        corners, surfaces = _subsurfaces(environment)
        count = len(corners)
        tree = cls(
            environment=environment,
            limits=limits,
            corners=corners,
            areas=_areas(corners),
            surfaces=surfaces,
            parents=np.full(count, -1),
            children=np.full((count, 2), -1),
            patch_nodes=np.zeros(0, dtype=np.int64),
            patches=np.full(count, -1),
        )
        most, least = tree.area_of(limits.patch_max), tree.area_of(limits.patch_min)
        tree = tree._divided(most, least, np.inf)
        patch_nodes = tree.elements
        if len(patch_nodes) > limits.max_elements:
            raise SceneTooLargeError(
                f"{len(patch_nodes)} patches are more than max_elements, {limits.max_elements}: raise it or patch_max"
            )
        patches = np.full(len(tree.corners), -1)
        patches[patch_nodes] = np.arange(len(patch_nodes))
        tree = replace(tree, patch_nodes=patch_nodes, patches=patches)
        return tree._divided(tree.area_of(limits.element_max), tree.area_of(limits.element_min), limits.max_elements)

    @property
    def elements(self) -> np.ndarray:
        """(q,) nodes that are not divided, ascending."""
        return np.flatnonzero(self.children[:, 0] < 0)

    def area_of(self, size: float) -> float:
        """Area of a square of a size in the limits' units."""
        corners = self.corners.reshape(-1, 3)
        longest = np.ptp(corners, axis=0).max() if len(corners) else 0.0
        return float(size * longest / UNITS) ** 2

    def polygons(self, nodes: np.ndarray) -> Environment:
        """Nodes as an environment of their own, with the colors and sides of their surfaces."""
        corners, surfaces = self.corners[nodes], self.surfaces[nodes]
        triangular = (corners[:, 2] == corners[:, 3]).all(axis=1)
        loops = [loop[:3] if short else loop for loop, short in zip(corners, triangular, strict=True)]
        known = self.environment
        return Environment.from_polygons(
            loops, known.reflectance[surfaces], known.emission[surfaces], known.two_sided[surfaces]
        )

    def split(self, nodes: np.ndarray) -> Hierarchy:
        """The hierarchy with some elements halved; their children come last, in pairs, in order of `nodes`."""
        first, second = _halves(self.corners[nodes])
        corners = np.stack((first, second), axis=1).reshape(-1, 4, 3)
        count = len(self.corners)
        children = np.concatenate((self.children, np.full((len(corners), 2), -1)))
        children[nodes] = count + np.arange(len(corners)).reshape(-1, 2)
        return replace(
            self,
            corners=np.concatenate((self.corners, corners)),
            areas=np.concatenate((self.areas, _areas(corners))),
            surfaces=np.concatenate((self.surfaces, np.repeat(self.surfaces[nodes], 2))),
            parents=np.concatenate((self.parents, np.repeat(nodes, 2))),
            children=children,
            patches=np.concatenate((self.patches, np.repeat(self.patches[nodes], 2))),
        )

    def refined(self, nodes: np.ndarray) -> Hierarchy:
        """`split`, but no element below `element_min`, and no more than `max_elements`; then balanced.

        Where the count does not suffice, earlier ones of `nodes` are split rather than later ones. Balance asks for
        more splits, which the least size does not prevent, or light would leak through the gaps; those that find no
        room any more take back nothing: the result may then lack balance at its finest elements.
        """
        nodes = nodes[self.areas[nodes] >= 2 * self.area_of(self.limits.element_min)]
        tree = self.split(np.sort(nodes[: self._room()]))
        while True:
            crowded = tree.crowded()[: tree._room()]
            if not len(crowded):
                return tree
            tree = tree.split(crowded)

    def crowded(self) -> np.ndarray:
        """Elements with more than one vertex of others on a side, ascending."""
        elements = self.elements
        starts, ends, owners = self.sides(elements)
        middles = (starts + ends) / 2
        quarters = np.concatenate(((starts + middles) / 2, (middles + ends) / 2))
        corners, *beside = numbered([starts, quarters[: len(starts)], quarters[len(starts) :]])
        crowded = np.isin(beside[0], corners) | np.isin(beside[1], corners)
        return elements[np.unique(owners[crowded])]

    def neighbors(self) -> np.ndarray:
        """(k, 2) places in `elements` of pairs that share a side, or half a side of one of them, and face alike."""
        elements = self.elements
        starts, ends, owners = self.sides(elements)
        first, middle, last = numbered([starts, (starts + ends) / 2, ends])
        size = int(max(first.max(initial=0), middle.max(initial=0), last.max(initial=0))) + 1
        # Of two that face alike, one goes along their common side forward, the other backward.
        whole = first * size + last
        order = np.argsort(whole, kind="stable")
        pairs = []
        for back in (last * size + first, middle * size + first, last * size + middle):
            begin, end = (np.searchsorted(whole[order], back, side) for side in ("left", "right"))
            lists = np.repeat(np.arange(len(back)), end - begin)
            places = np.arange(len(lists)) - np.repeat(np.cumsum(end - begin) - (end - begin), end - begin)
            pairs.append(np.stack((owners[lists], owners[order[begin[lists] + places]]), axis=1))
        found = np.unique(np.sort(np.concatenate(pairs), axis=1), axis=0)
        normals = self.environment.normals[self.surfaces[elements]]
        return found[np.einsum("ki,ki->k", normals[found[:, 0]], normals[found[:, 1]]) > COPLANAR]

    def _room(self) -> int:
        return max(self.limits.max_elements - len(self.elements), 0)

    def _divided(self, most, least, count):
        """Halve elements above an area, largest first, none below `least`, until there are `count`."""
        tree = self
        while True:
            elements = tree.elements
            # A relative margin: an area met exactly but for rounding is small enough.
            large = (tree.areas[elements] > most * (1 + 1e-9)) & (tree.areas[elements] >= 2 * least * (1 - 1e-9))
            chosen = elements[large]
            room = count - len(elements)
            if room < len(chosen):
                chosen = np.sort(chosen[np.argsort(-tree.areas[chosen], kind="stable")][: max(int(room), 0)])
            if not len(chosen):
                return tree
            tree = tree.split(chosen)

    def sides(self, nodes: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Starts and ends (s, 3) of the sides of nodes, node after node, and the place in `nodes` of each (s,)."""
        corners = self.corners[nodes]
        following = np.roll(corners, -1, axis=1)
        owners, number = np.nonzero((corners != following).any(axis=2))
        return corners[owners, number], following[owners, number], owners


def _subsurfaces(environment):
    """Corners (s, 4, 3) and surface (s,) of the parts that are halved."""
    sizes = np.array([len(loop) for loop in environment.polygons])
    quads = np.flatnonzero((sizes == 4) & (environment.areas > 0))
    loops = np.array([environment.polygons[row] for row in quads]).reshape(-1, 4, 3)
    sides = np.roll(loops, -1, axis=1) - loops
    turns = np.einsum("nki,ni->nk", np.cross(np.roll(sides, 1, axis=1), sides), environment.normals[quads])
    convex = (turns > 0).all(axis=1)
    quads, loops = quads[convex], loops[convex]
    others = ~np.isin(environment.triangle_patches, quads)
    triangles = environment.vertices[environment.triangles[others]][:, [0, 1, 2, 2]]
    surfaces = np.concatenate((quads, environment.triangle_patches[others])).astype(np.int64)
    order = np.argsort(surfaces, kind="stable")
    # Negative zeros would make equal places differ.
    return np.concatenate((loops, triangles))[order] + 0.0, surfaces[order]


def _areas(corners):
    """Areas (n,) of planar convex quadrilaterals (n, 4, 3)."""
    return np.linalg.norm(np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1]), axis=1) / 2


def _halves(corners):
    """Both halves, each (n, 4, 3)."""
    lengths = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
    triangular = (corners[:, 2] == corners[:, 3]).all(axis=1)
    # The cut goes through the first side: corners are turned until that is one of the two longer ones, or the longest.
    across = lengths[:, 0] + lengths[:, 2] < lengths[:, 1] + lengths[:, 3]
    turns = np.where(triangular, lengths[:, [0, 1, 3]].argmax(axis=1), across)
    places = (turns[:, None] + np.arange(4)) % np.where(triangular, 3, 4)[:, None]
    a, b, c, d = (corners[np.arange(len(corners)), places[:, corner]] for corner in range(4))
    near = (a + b) / 2
    far = np.where(triangular[:, None], c, (c + d) / 2)
    d = np.where(triangular[:, None], c, d)
    return np.stack((a, near, far, d), axis=1), np.stack((near, b, c, far), axis=1)


def numbered(places: list[np.ndarray]) -> list[np.ndarray]:
    """Numbers for places, each (s, 3), the same where coordinates are equal bit for bit."""
    _, numbers = np.unique(np.concatenate(places), axis=0, return_inverse=True)
    return np.split(numbers.reshape(-1), np.cumsum([len(place) for place in places])[:-1])
