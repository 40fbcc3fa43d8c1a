"""What a solved set of patches says about its own correctness: power in and out, closure, reciprocity."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..light_groups import whole
from .patch_solution import PatchSolution

#: Luminance weights of Rec. 709.
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


@dataclass(frozen=True)
class PatchChecks:
    """Shares of the power that lamps and sky bring to patches and that patches emit, and the errors found.

    That power is absorbed, or escapes, or is missing. Absorbed is what patches do not reflect of what arrives at them,
    and what they send to backs taken as black: of materials with one side, and inside solids. Light that slips into a
    solid through a crack is therefore no error; a few tenths of a percent do so in furnished rooms. Escaped is what
    patches send to the sky or past everything, by their own rays. Light of lamps that meets no patch is not counted at
    all. Of patches that are partly inside a solid the open part counts, as it does in the solution.

    `energy_balance_error` is the part that is neither absorbed nor gone, or that is so without having been emitted: how
    far the form factors are from reciprocal, weighted by the light they carry, and what the solver has left undone.
    Backs that only receivers have met (`PatchSolution.follow`) take light that nobody gives away, and count in full.
    `closure_error_max` and `reciprocity_error_max` are those of the form factors between groups of fronts, relative to
    the area of all and to the largest exchange.
    """

    light_absorbed: float
    light_escaped: float
    energy_balance_error: float
    closure_error_max: float
    reciprocity_error_max: float


def check_patches(solution: PatchSolution) -> PatchChecks:
    """Balance the power of the fronts and backs worked on."""
    table = solution.hits_to_rows
    count = solution.patches.count
    areas = solution.open_areas
    dark = solution.dark_rows()
    outside = table.is_outside()
    luminous, emitted, irradiance, given = (
        whole(values) @ LUMINANCE
        for values in (solution.radiosity, solution.emitted, solution.irradiance, solution.given())
    )
    beyond = np.zeros(2 * count)
    absorbed = escaped = lit = 0.0
    for rows, _, seen, kept in solution.gathered_sides():
        weight = kept / kept.sum(axis=1, keepdims=True)
        gone, swallowed = (
            (marked[seen.rows].mean(axis=1).reshape(weight.shape) * weight).sum(axis=1) for marked in (outside, dark)
        )
        beyond[rows] = ((seen.rows >= 2 * count).mean(axis=1).reshape(weight.shape) * weight).sum(axis=1)
        lit += float(areas[rows] @ (given[rows] + emitted[rows]))
        # Dark backs keep what others send them; what their own few rays to the light have found is no better.
        arrived = np.where(dark[rows], given[rows], irradiance[rows])
        absorbed += float(areas[rows] @ (arrived + emitted[rows] - luminous[rows] * (1 - swallowed)))
        escaped += float(areas[rows] @ (luminous[rows] * gone))
    closure, reciprocity = _identities(solution, beyond)
    sent = max(lit, 1e-300)
    return PatchChecks(
        light_absorbed=absorbed / sent if lit > 0 else 0.0,
        light_escaped=escaped / sent if lit > 0 else 0.0,
        energy_balance_error=abs(lit - absorbed - escaped) / sent if lit > 0 else 0.0,
        closure_error_max=closure,
        reciprocity_error_max=reciprocity,
    )


def _identities(solution: PatchSolution, beyond: np.ndarray) -> tuple[float, float]:
    """Largest errors of closure and of reciprocity, from the share (2P,) of each patch's rays that meet no patch."""
    groups = _groups(solution)
    count, total = len(groups), int(groups.max()) + 1
    # One more for backs and whatever lies beyond.
    groups = np.concatenate([groups, np.full(count, total)])
    areas = solution.open_areas
    exchange = np.zeros((total + 1) ** 2)
    for part in solution.factors.slices:
        key = groups[part.rows][:, None] * (total + 1) + groups[part.columns]
        power = areas[part.rows][:, None] * part.weights
        exchange += np.bincount(key.ravel(), weights=power.ravel(), minlength=len(exchange))
    exchange = exchange.reshape(total + 1, total + 1)[:total]
    exchange[:, total] += np.bincount(groups, weights=areas * beyond, minlength=total + 1)[:total]
    surface = np.bincount(groups, weights=areas, minlength=total + 1)[:total]
    flux = exchange[:, :total]
    closure = np.abs(exchange.sum(axis=1) - surface).max() / max(float(surface.sum()), 1e-300)
    return float(closure), float(np.abs(flux - flux.T).max() / max(float(flux.max()), 1e-300))


def _groups(solution: PatchSolution) -> np.ndarray:
    """Group (P,) of each patch: by the side its normal faces and the octant it lies in."""
    normals = solution.patches.normals[:, 0]
    axis = np.abs(normals).argmax(axis=1)
    side = 2 * axis + (np.take_along_axis(normals, axis[:, None], axis=1)[:, 0] > 0)
    octant = (solution.patches.points[:, 0] > 0) @ np.array([1, 2, 4])
    _, groups = np.unique(side * 8 + octant, return_inverse=True)
    return groups.reshape(-1)
