"""What a solution by a full matrix says about its own correctness: power in and out, closure, reciprocity."""

from __future__ import annotations

import numpy as np

from .matrix_solution import MatrixSolution
from .patch_checks import LUMINANCE, PatchChecks


def check_matrix(solution: MatrixSolution) -> PatchChecks:
    """Balance the power of the fronts and backs that exchange light.

    What a row lacks to a sum of 1 has escaped. Errors of closure and reciprocity are those of the factors that were
    solved with, after their repair.
    """
    rows = np.flatnonzero(solution.exchanging)
    emitted, radiosity = solution.emitted[rows] @ LUMINANCE, solution.solution.radiosity @ LUMINANCE
    exchanged = solution.matrix @ radiosity
    irradiance = solution.irradiance[rows] @ LUMINANCE
    lit = float(solution.areas @ (irradiance - exchanged + emitted))
    absorbed = float(solution.areas @ (irradiance + emitted - radiosity))
    escaped = float((solution.areas * (1 - solution.matrix.sum(axis=1))) @ radiosity)
    sent = max(lit, 1e-300)
    return PatchChecks(
        light_absorbed=absorbed / sent if lit > 0 else 0.0,
        light_escaped=escaped / sent if lit > 0 else 0.0,
        energy_balance_error=abs(lit - absorbed - escaped) / sent if lit > 0 else 0.0,
        closure_error_max=solution.polygon_factors.closure_error,
        reciprocity_error_max=solution.polygon_factors.reciprocity_error,
    )


def matrix_statistics(solution: MatrixSolution) -> dict:
    """JSON-ready numbers beside those of any bake: which methods computed how many factors, and how wrong they were
    before their repair."""
    factors = solution.polygon_factors
    return {
        "method": solution.method,
        "solver": solution.solution.method,
        "polygons": len(factors.matrix),
        "method_counts": dict(factors.method_counts),
        "form_factor_seconds": round(factors.seconds, 4),
        "form_factor_error": factors.estimated_error,
        "raw_closure_error": factors.raw_closure_error,
        "raw_reciprocity_error": factors.raw_reciprocity_error,
    }


def matrix_warnings(solution: MatrixSolution) -> list[str]:
    """What a method says about itself, for the report: that its limits ended it before the accuracy asked for."""
    error = solution.polygon_factors.estimated_error
    if error <= solution.factor_accuracy:
        return []
    return [
        f"Form factors by {solution.method} may be off by {error:.2g}, not {solution.factor_accuracy:.2g} as asked "
        "for: the method reached its limit of samples"
    ]
