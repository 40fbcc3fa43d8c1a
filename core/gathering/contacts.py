"""Contacts: borders of faces next to which something rises, as in the corner of a room or at the foot of a crate.

Light falls steeply towards such an edge and hardly changes along it, so these receivers are interpolated among each
other only. Other borders, the outer edges of a crate say, are lit as the face beside them.
"""

from __future__ import annotations

import numpy as np

from ..visibility.embree import CHUNK_RAYS, OFFSET, RayPool, Tracer
from .receivers import Receivers

#: How far they look, in sizes of the faces around. What stands off by more is near, but no contact.
REACH = 0.1

#: Length of the sum of the directions to a contact's neighbors above which it is an end: 0 on a straight edge, 1 at an
#: end and 1.4 at a right angle.
TURN = 0.5

#: Azimuths (radians) from straight outward of the rays that look for what rises beside a border, at 45 degrees up.
AZIMUTHS = (-np.pi / 3, 0.0, np.pi / 3)


def find_contacts(tracer: Tracer, receivers: Receivers, pool: RayPool) -> np.ndarray:
    """(r,) bool: receivers on borders from which something rises beside their face."""
    borders = np.nonzero(receivers.borders)[0]
    met = np.zeros(len(borders), bool)

    def work(start: int, stop: int) -> None:
        who = borders[start:stop]
        normals = receivers.normals[who]
        outward = -receivers.inward[who] / np.maximum(np.linalg.norm(receivers.inward[who], axis=1), 1e-20)[:, None]
        aside = np.cross(normals, outward)
        origins = (receivers.points[who] + np.float32(OFFSET) * normals).astype(np.float32)
        for azimuth in AZIMUTHS:
            along = np.cos(azimuth) * outward + np.sin(azimuth) * aside + normals
            segments = (np.float32(REACH) * receivers.sizes[who, None] * along).astype(np.float32)
            met[start:stop] |= tracer.visibility(origins, segments, 1.0) < 1

    pool.run(work, len(borders), CHUNK_RAYS)
    contacts = np.zeros(len(receivers), bool)
    contacts[borders[met]] = True
    return contacts


def find_ends(receivers: Receivers, contacts: np.ndarray) -> np.ndarray:
    """(r,) bool: contacts at which a contact ends or turns, as in the corner of a room.

    There the light depends on a third surface, or falls from beside what rises, and neighbors tell little of it.
    """
    edges = receivers.edges[contacts[receivers.edges].all(axis=1)]
    along = receivers.points[edges[:, 1]] - receivers.points[edges[:, 0]]
    along = along / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-20)
    count = len(receivers)
    degree = np.bincount(edges.ravel(), minlength=count)
    pull = np.stack(
        [
            np.bincount(edges[:, 0], weights=along[:, k], minlength=count)
            - np.bincount(edges[:, 1], weights=along[:, k], minlength=count)
            for k in range(3)
        ],
        axis=1,
    )
    return contacts & ((degree == 0) | (np.linalg.norm(pull, axis=1) > TURN))
