"""Receivers where the surface is: on the mesh as it was read, or on what its modifiers made of it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..scene import ReceiverMesh
from ..visibility.embree import Frame, RayPool, Tracer, free_ways
from .receivers import Receivers, build_receivers
from .snapping import snap_to_surface


def place_receivers(meshes: Sequence[ReceiverMesh], tracer: Tracer, pool: RayPool) -> Receivers:
    """Receivers of meshes in the unit frame; those of meshes that lie off the surface are moved onto it."""

    def parts(places: np.ndarray, others: np.ndarray) -> np.ndarray:
        return ~free_ways(tracer, places, others - places, pool)

    receivers = build_receivers(meshes, Frame(np.zeros(3), 1.0), parts)
    if not any(mesh.is_off_surface for mesh in meshes):
        return receivers
    chosen = np.zeros(len(receivers), bool)
    for mesh, corners in zip(meshes, receivers.corner_receivers, strict=True):
        if mesh.is_off_surface:
            chosen[corners[corners >= 0]] = True
    return snap_to_surface(tracer, receivers, chosen, pool)
