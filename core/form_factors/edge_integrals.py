"""Double line integral of the logarithm of distance over pairs of straight edges: the term of Goral's contour integral.

For two edges with vectors a and b, ``a . b`` times the mean of ``ln r`` over both. Parallel edges have an elementary
closed form, whether they coincide, overlap, touch or lie far apart; perpendicular edges give nothing. Other pairs are
integrated along one edge in closed form and along the other by Gauss's rule, on pieces graded toward the points where
the closed form is not analytic. These are known: the places abreast of the other edge's ends, and of the crossing of
the two lines, each as far off the path as the other edge stays away. So touching and crossing edges need no special
case, and no error has to be guessed: orders and pieces follow from the theory of Gauss's rule.

Cost: 4 logarithms and arc tangents for a parallel pair, 6 to 16 times as many for others, more where they nearly touch.
Results are good to some roundings of the edges' lengths multiplied, whatever angle they enclose.
"""

from __future__ import annotations

from functools import cache

import numpy as np

#: Sine of the angle between edges that count as parallel. Turning one of them by this moves its ends by less than the
#: rounding of coordinates does.
PARALLEL = 1e-14

#: Cosine below which a pair is perpendicular: what is left out is below the rounding of the other terms.
PERPENDICULAR = 1e-16

#: Gauss orders that pieces are integrated with.
ORDERS = (4, 6, 10, 16)

#: Error allowed to the mean of ``ln r`` over a piece, where all digits are wanted. Gauss's rule of order n errs by the
#: Bernstein parameter (sum of the half-axes of the largest ellipse about the piece, in half lengths, in which the
#: integrand is analytic) to the power -2 n; the constant before it is small for logarithms.
EXACT = 1e-13

#: Pieces handled at once: 16 points each, about 20 temporaries of 8 bytes, stay below 64 MB.
BLOCK_PIECES = 2**14


@cache
def gauss_rule(order: int) -> tuple[np.ndarray, np.ndarray]:
    """Nodes between -1 and 1 and weights of Gauss's rule."""
    return np.polynomial.legendre.leggauss(order)


def edge_integrals(starts, edges, other_starts, other_edges, tolerance=EXACT) -> np.ndarray:
    """``a . b`` times the mean of ``ln r`` over n pairs of edges.

    Parameters
    ----------
    starts, edges : (n, 3) float
        First ends and vectors of one edge of each pair, in units such that distances are around 1: the result's
        rounding is that of ``|a| |b| max(1, |ln r|)``.
    other_starts, other_edges : (n, 3) float
        Those of the other.
    tolerance : float or (n,) float
        Error allowed to the mean of ``ln r``; parallel pairs are exact at any.

    Returns
    -------
    (n,) float64

    References
    ----------
    .. [1] Goral, Torrance, Greenberg, Battaile, "Modeling the Interaction of Light Between Diffuse Surfaces",
       SIGGRAPH 1984, eq. 15.
    .. [2] Trefethen, "Is Gauss Quadrature Better than Clenshaw-Curtis?", SIAM Review 50(1), 2008 (error of the rule).
    """
    weights = _dot(edges, other_edges)
    squares = _dot(edges, edges) * _dot(other_edges, other_edges)
    crosses = np.cross(edges, other_edges)
    parallel = _dot(crosses, crosses) <= PARALLEL**2 * squares
    slanted = ~parallel & (weights * weights > PERPENDICULAR**2 * squares)
    parallel &= squares > 0
    result = np.zeros(len(weights))
    rows = np.flatnonzero(parallel)
    result[rows] = _parallel(starts[rows], edges[rows], other_starts[rows], other_edges[rows])
    rows = np.flatnonzero(slanted)
    tolerance = np.broadcast_to(tolerance, weights.shape)[rows]
    result[rows] = _slanted(starts[rows], edges[rows], other_starts[rows], other_edges[rows], tolerance)
    return result


def _dot(left, right):
    return np.einsum("...i,...i->...", left, right)


def _parallel(starts, edges, other_starts, other_edges):
    """Second antiderivative of ``ln r`` at the four distances between ends, measured along the edges."""
    lengths = np.sqrt(_dot(edges, edges))
    along = edges / lengths[:, None]
    apart = other_starts - starts
    first = _dot(apart, along)
    across = apart - first[:, None] * along
    height = np.sqrt(_dot(across, across))
    last = first + _dot(other_edges, along)
    return (
        _second_antiderivative(last, height)
        - _second_antiderivative(last - lengths, height)
        - _second_antiderivative(first, height)
        + _second_antiderivative(first - lengths, height)
    )


def _second_antiderivative(x, height):
    """The even function of x whose second derivative is ``ln(x^2 + height^2) / 2``."""
    square = x * x + height * height
    logarithm = np.log(np.where(square > 0, square, 1))
    return (x * x - height * height) * logarithm / 4 + height * x * np.arctan2(x, height) - 0.75 * x * x


def _slanted(starts, edges, other_starts, other_edges, tolerance):
    """Pairs at an angle: pieces of the first edge, halved until Gauss's rule is known to be exact on them."""
    weights = _dot(edges, other_edges)
    # The shorter edge is the one that is cut: it has fewer pieces, and the closed form serves the longer one.
    swap = _dot(edges, edges) > _dot(other_edges, other_edges)
    if swap.any():
        swap = swap[:, None]
        starts, other_starts = np.where(swap, other_starts, starts), np.where(swap, starts, other_starts)
        edges, other_edges = np.where(swap, other_edges, edges), np.where(swap, edges, other_edges)
    lines = _Lines(starts, edges, other_starts, other_edges)
    totals = np.zeros(len(starts))
    rows, centers, halves = np.arange(len(starts)), np.full(len(starts), 0.5), np.full(len(starts), 0.5)
    while len(rows):
        parameter = lines.smoothness(rows, centers, halves)
        # What remains of a kink or a logarithm in a piece weighs the square of its length.
        order = np.where(halves * halves < tolerance[rows] / 4, ORDERS[-1], 0)
        for points in reversed(ORDERS):
            order[parameter ** (-2.0 * points) <= tolerance[rows]] = points
        for points in ORDERS:
            chosen = np.flatnonzero(order == points)
            for begin in range(0, len(chosen), BLOCK_PIECES):
                block = chosen[begin : begin + BLOCK_PIECES]
                values = lines.integrate(rows[block], centers[block], halves[block], points)
                totals += np.bincount(rows[block], values, len(totals))
        open_ = order == 0
        rows, halves = np.repeat(rows[open_], 2), np.repeat(halves[open_] / 2, 2)
        centers = np.repeat(centers[open_], 2) + halves * np.tile([-1.0, 1.0], len(halves) // 2)
    return weights * totals


class _Lines:
    """n pairs of edges, one parametrized from 0 to 1, the other integrated in closed form.

    Seen from the second edge's start, the point at parameter s lies at ``first + s * slope`` along it and at
    ``across + s * drift`` off it.
    """

    def __init__(self, starts, edges, other_starts, other_edges):
        self.length = np.sqrt(_dot(other_edges, other_edges))
        along = other_edges / self.length[:, None]
        apart = starts - other_starts
        self.first, self.slope = _dot(apart, along), _dot(edges, along)
        self.across = apart - self.first[:, None] * along
        self.drift = edges - self.slope[:, None] * along
        self.poles = self._singularities(starts, edges, other_starts, other_edges)

    def _singularities(self, starts, edges, other_starts, other_edges):
        """(3, n) complex parameters, of either sign of the imaginary part, where the closed form is not analytic."""
        square = _dot(edges, edges)
        poles = []
        for end in (other_starts, other_starts + other_edges):
            offset = end - starts
            place = _dot(offset, edges) / square
            away = offset - place[:, None] * edges
            poles.append(place + 1j * np.sqrt(_dot(away, away) / square))
        drift_square = _dot(self.drift, self.drift)
        place = -_dot(self.across, self.drift) / drift_square
        away = self.across + place[:, None] * self.drift
        crossing = place + 1j * np.sqrt(_dot(away, away) / drift_square)
        # Where the lines cross beyond the second edge's ends, its closed form is analytic.
        met = self.first + crossing * self.slope
        beyond = np.maximum(-met.real, met.real - self.length)
        crossing[beyond > np.abs(met.imag)] = np.inf
        poles.append(crossing)
        return np.array(poles)

    def smoothness(self, rows, centers, halves):
        """Bernstein parameter (r,) of pieces: how far the nearest singularity is, in the metric of Gauss's rule."""
        place = self.poles[:, rows]
        far = np.isinf(place.real)
        place = (np.where(far, 0, place) - centers) / halves
        # Sum of the distances from the two ends of the piece, in half lengths, is the major axis of the ellipse.
        axis = (np.abs(place - 1) + np.abs(place + 1)) / 2
        parameter = axis + np.sqrt(np.maximum(axis * axis - 1, 0))
        return np.where(far, np.inf, parameter).min(axis=0)

    def integrate(self, rows, centers, halves, order):
        """Integral (r,) over pieces of the mean of ``ln r`` over the second edge."""
        nodes, weights = gauss_rule(order)
        places = centers[:, None] + halves[:, None] * nodes
        low = -(self.first[rows][:, None] + places * self.slope[rows][:, None])
        high = low + self.length[rows][:, None]
        height = np.zeros_like(places)
        for axis in range(3):
            height += (self.across[rows, axis][:, None] + places * self.drift[rows, axis][:, None]) ** 2
        values = _antiderivative(high, height) - _antiderivative(low, height)
        return values @ weights * halves / self.length[rows]


def _antiderivative(x, square_height):
    """The odd function of x whose derivative is ``ln(x^2 + square_height) / 2``."""
    square = x * x + square_height
    height = np.sqrt(square_height)
    return x * (np.log(np.where(square > 0, square, 1)) / 2 - 1) + height * np.arctan2(x, height)
