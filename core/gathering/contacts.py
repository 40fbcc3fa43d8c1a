"""Contacts: borders of faces next to which something rises, as in the corner of a room or at the foot of a crate.

Light falls steeply towards such an edge and hardly changes along it, so these receivers are interpolated among each
other only. Other borders, the outer edges of a crate say, are lit as the face beside them.
"""

from __future__ import annotations

import numpy as np

from ..visibility.embree import CHUNK_RAYS, OFFSET, RayPool, Tracer
from .receivers import Receivers

#: Azimuths (radians) from straight outward of the rays that look for what rises beside a border, at 45 degrees up.
AZIMUTHS = (-np.pi / 3, 0.0, np.pi / 3)


def find_contacts(tracer: Tracer, receivers: Receivers, pool: RayPool) -> np.ndarray:
    """(r,) bool: receivers on borders from which something rises outside of their face, nearer than the mesh is fine."""
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
            segments = (receivers.sizes[who, None] * along).astype(np.float32)
            met[start:stop] |= tracer.visibility(origins, segments, 1.0) < 1

    pool.run(work, len(borders), CHUNK_RAYS)
    contacts = np.zeros(len(receivers), bool)
    contacts[borders[met]] = True
    return contacts
