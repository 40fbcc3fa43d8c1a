"""What a solved set of patches says about its own correctness: power in and out, closure, reciprocity."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .patch_solution import PatchSolution

#: Luminance weights of Rec. 709.
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


@dataclass(frozen=True)
class PatchChecks:
    """Shares of the power that lights, emissive patches and sky send into the scene, and the errors found.

    `energy_balance_error` is the part of it that is neither absorbed nor gone: it measures how far the sampled form
    factors are from reciprocal, weighted by the light they carry. `closure_error_max` and `reciprocity_error_max` are
    those of the form factors between groups of patches, relative to the largest.
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
    areas = np.concatenate([solution.patches.areas, solution.patches.areas])
    sky = np.zeros(table.rows, bool)
    sky[table.sky_start : table.sky_start + table.sky_cells] = True
    outside = table.is_outside()
    values = solution.table()[:, :3] @ LUMINANCE
    groups = _groups(solution)
    total = int(groups.max()) + 1
    exchange = np.zeros((total, total + 1))
    arriving = absorbed = escaped = lit = 0.0
    luminous = solution.radiosity @ LUMINANCE
    for rows, direct, seen, kept in solution.gathered_sides():
        weight = kept / kept.sum(axis=1, keepdims=True)
        area = areas[rows]
        gone = (outside[seen.rows].mean(axis=1).reshape(weight.shape) * weight).sum(axis=1)
        from_sky = ((values * sky)[seen.rows].mean(axis=1).reshape(weight.shape) * weight).sum(axis=1)
        given = ((direct @ LUMINANCE) * weight).sum(axis=1)
        emitted = solution.emitted[rows] @ LUMINANCE
        irradiance = solution.irradiance[rows] @ LUMINANCE
        lit += float((area * (given + from_sky + emitted)).sum())
        absorbed += float((area * (irradiance + emitted - luminous[rows])).sum())
        escaped += float((area * luminous[rows] * gone).sum())
        arriving += float((area * irradiance).sum())
        fronts = rows < count
        _add_exchange(exchange, groups, rows[fronts], area[fronts], seen.rows.reshape(len(rows), -1)[fronts], count)
    closure = np.abs(exchange.sum(axis=1) - np.bincount(groups, weights=solution.patches.areas, minlength=total))
    flux = exchange[:, :total]
    largest = max(float(flux.max(initial=0)), 1e-300)
    sent = max(lit, 1e-300)
    return PatchChecks(
        light_absorbed=absorbed / sent if lit > 0 else 0.0,
        light_escaped=escaped / sent if lit > 0 else 0.0,
        energy_balance_error=abs(lit - absorbed - escaped) / sent if lit > 0 else 0.0,
        closure_error_max=float((closure / max(float(solution.patches.areas.sum()), 1e-300)).max(initial=0)),
        reciprocity_error_max=float(np.abs(flux - flux.T).max(initial=0)) / largest,
    )


def _groups(solution: PatchSolution) -> np.ndarray:
    """Group (P,) of each patch: by the side its normal faces and the octant it lies in."""
    normals = solution.patches.normals[:, 0]
    axis = np.abs(normals).argmax(axis=1)
    side = 2 * axis + (np.take_along_axis(normals, axis[:, None], axis=1)[:, 0] > 0)
    octant = (solution.patches.points[:, 0] > 0) @ np.array([1, 2, 4])
    _, groups = np.unique(side * 8 + octant, return_inverse=True)
    return groups.reshape(-1)


def _add_exchange(exchange, groups, patches, areas, seen, count) -> None:
    total = len(exchange)
    target = np.full(seen.shape, total)
    front = seen < count
    target[front] = groups[seen[front]]
    weight = np.repeat(areas / seen.shape[1], seen.shape[1])
    key = (groups[patches][:, None] * (total + 1) + target).ravel()
    exchange += np.bincount(key, weights=weight, minlength=total * (total + 1)).reshape(total, total + 1)
