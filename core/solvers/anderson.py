"""Anderson's acceleration: of the last steps of an iteration, the mix whose changes cancel best (Walker and Ni 2011).

An iteration x, f(x), f(f(x)), ... that creeps towards its fixed point does so along few directions, which the last
steps show. It costs a few scalar products a step, and serves maps of which nothing is known but their values. Limits:
where f is the product of a known matrix, `gmres` does the same with proofs.
"""

from __future__ import annotations

import numpy as np

#: Earlier steps to look back on.
MEMORY = 8


def mixed(steps: list[np.ndarray], changes: list[np.ndarray]) -> np.ndarray:
    """The mix of the last steps whose changes cancel best, per channel, and nowhere below 0.

    Parameters
    ----------
    steps, changes : lists of (n, c) float
        Values f(x), and f(x) - x, the last one being the newest.

    References
    ----------
    .. [1] Walker, Ni, "Anderson Acceleration for Fixed-Point Iterations", SIAM Journal on Numerical Analysis 49(4),
       2011.
    """
    if len(steps) == 1:
        return steps[0]
    out = np.empty_like(steps[-1])
    for channel in range(out.shape[1]):
        last = changes[-1][:, channel].astype(np.float64)
        differences = np.stack([last - c[:, channel] for c in changes[:-1]])
        # Normal equations with a small tie: few unknowns, and nearly parallel changes must not blow up. By einsum: a
        # matrix product of this shape waits for threads longer than it works.
        normal = np.einsum("ki,li->kl", differences, differences)
        normal += np.eye(len(normal)) * (1e-10 * np.trace(normal) + 1e-300)
        mix = np.linalg.solve(normal, np.einsum("ki,i->k", differences, last))
        total = steps[-1][:, channel].astype(np.float64)
        for weight, step in zip(mix, steps[:-1], strict=True):
            total = total + weight * (step[:, channel] - steps[-1][:, channel])
        out[:, channel] = np.maximum(total, 0)
    return out
