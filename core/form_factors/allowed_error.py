"""Allowed error: what an `accuracy` asked for means for a single form factor.

An `accuracy` of a says that a factor above 10 a is right to the share a of itself, and a smaller one to 10 a**2. So
1e-3 asks for one part in a thousand of a factor of 0.01 or more and for 1e-5 of those below: what a patch receives from
many small factors is as good as what it receives from few large ones, and none is asked for a share that is lost in
the sum of its row.

Methods that sample pairs (contour integral, point to polygon and hybrid among blockers, hemisphere) state standard
errors and aim at `AIM` of what is allowed, so that about one factor in a hundred differs by more than twice of it.
Projections, disks and point to point keep one absolute error for all factors of a row (`matrix`), which no factor's
allowed error exceeds.
"""

from __future__ import annotations

import numpy as np

#: Standard error at which sampling stops, as a share of the allowed error: 2 / 0.7 = 2.9 standard errors of a normal
#: distribution leave 0.4 % outside of twice the allowed error, the heavier tails of few repetitions about 1 %.
AIM = 0.7

#: Factors below this many times `accuracy` are judged by an absolute error.
SMALL = 10.0


def allowed_error(factors: np.ndarray | float, accuracy: float) -> np.ndarray | float:
    """Error allowed for each factor, in the shape of `factors`: ``accuracy * max(F, 10 accuracy)``."""
    return accuracy * np.maximum(factors, SMALL * accuracy)
