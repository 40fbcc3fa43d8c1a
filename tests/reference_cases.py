"""The published reference values in `tests/reference/`, ready for tests; its README tells where they come from."""

import json
from functools import cache
from pathlib import Path

import numpy as np
from radiosity import core

FOLDER = Path(__file__).parent / "reference"


@cache
def form_factor_cases():
    """Cases of form_factors.json by id."""
    return _load("form_factors.json")


@cache
def solution_cases():
    """Cases of solutions.json by id."""
    return _load("solutions.json")


def _load(name):
    cases = json.loads((FOLDER / name).read_text(encoding="utf-8"))["cases"]
    return {case["id"]: case for case in cases}


def ids(cases, *classes, tag=None):
    """Ids of the cases of some classes, optionally with a tag."""
    chosen = [case for case in cases.values() if case["class"] in classes]
    return [case["id"] for case in chosen if tag is None or tag in (case.get("tags") or ())]


def allowed(case, level, value):
    """Deviation (absolute) that a form-factor case allows at a tolerance level."""
    tolerance = case["tolerance"][level]
    return np.maximum(tolerance["abs"], tolerance["rel"] * np.abs(value))


def polygons_of(case):
    """All polygons of a case, and the row of the surface that each belongs to."""
    surfaces = case["surfaces"]
    polygons = [_corners(polygon) for surface in surfaces for polygon in surface["polygons"]]
    owners = [row for row, surface in enumerate(surfaces) for _ in surface["polygons"]]
    return polygons, np.array(owners)


def _corners(polygon):
    # JSON knows no NaN: the cases write it as a string, which NumPy reads.
    return np.array([[float(value) for value in corner] for corner in polygon])


def surface_matrix(case, **choices):
    """Form factors between a case's surfaces, their areas, and the result they come from."""
    polygons, owners = polygons_of(case)
    environment = core.Environment.from_polygons(polygons)
    result = core.form_factors(environment, **choices)
    members = (owners[:, None] == np.arange(len(case["surfaces"]))).astype(float)
    areas = members.T @ environment.areas
    matrix = members.T @ (environment.areas[:, None] * result.matrix) @ members
    return matrix / np.where(areas > 0, areas, 1)[:, None], areas, result


def in_order(case, values, order):
    """Rows (and columns of a matrix) of per-surface values in the order of a list of names."""
    names = [surface["name"] for surface in case["surfaces"]]
    rows = [names.index(name) for name in order]
    return values[np.ix_(rows, rows)] if values.ndim == 2 else values[rows]
