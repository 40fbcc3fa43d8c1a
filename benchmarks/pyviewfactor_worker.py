"""Form factors by pyviewfactor, in a process of the environment that has it; `versus_pyviewfactor` starts and asks it.

One request a line on standard input, parted by tabs: a mesh (.npz with corners (c, 3) and the number (n,) of corners of
each patch), a file for the result (.npy), and 1 where patches block each other, else 0. The answer is one line of JSON
on standard output with ``seconds`` and ``cpu_seconds``. What Numba compiles at first use is no part of them. This file
needs what pyviewfactor needs and nothing else.
"""

from __future__ import annotations

import json
import sys
import time

import numpy as np
import pyviewfactor
import pyvista


def view_factors(corners: np.ndarray, counts: np.ndarray, occluded: bool) -> np.ndarray:
    """Share (n, n) of what leaves the row's patch that reaches the column's."""
    ends = np.cumsum(counts)
    faces = [np.concatenate(([count], np.arange(end - count, end))) for count, end in zip(counts, ends, strict=True)]
    mesh = pyvista.PolyData(corners, np.concatenate(faces))
    # Theirs is the share that leaves the column's.
    return pyviewfactor.compute_viewfactor_matrix(
        mesh, obstacles=[mesh] if occluded else None, skip_obstruction=not occluded
    ).T


def main() -> None:
    plate = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=float)
    for occluded in (False, True):
        view_factors(np.concatenate((plate, np.add(plate[::-1], (0, 0, 1)))), np.array([4, 4]), occluded)
    print(json.dumps({"version": pyviewfactor.__version__}), flush=True)
    for line in sys.stdin:
        mesh, result, occluded = line.rstrip("\n").split("\t")
        with np.load(mesh) as stored:
            corners, counts = stored["corners"], stored["counts"]
        begin, cpu_begin = time.perf_counter(), time.process_time()
        matrix = view_factors(corners, counts, occluded == "1")
        took = {"seconds": time.perf_counter() - begin, "cpu_seconds": time.process_time() - cpu_begin}
        np.save(result, matrix)
        print(json.dumps(took), flush=True)


if __name__ == "__main__":
    main()
