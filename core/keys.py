"""Grouping rows of integers: one 64-bit key per row, cheap to sort.

Two different rows share a key with a probability of 2^-64 a pair, below 1e-7 for a million rows.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

#: Parts in which pairs are sorted, by their lower number: each takes an eighth of the memory.
PARTS = 8


def row_keys(*columns: np.ndarray) -> np.ndarray:
    """Keys (n,) uint64 of rows given as integer columns (n,), mixed by multiply and shift (constants of splitmix64)."""
    key = np.zeros(len(columns[0]), np.uint64)
    for column in columns:
        key ^= column.astype(np.int64).view(np.uint64)
        key *= np.uint64(0x9E3779B97F4A7C15)
        key ^= key >> np.uint64(29)
    return key * np.uint64(0xBF58476D1CE4E5B9)


def unique_pairs(one: np.ndarray, other: np.ndarray, count: int) -> np.ndarray:
    """Undirected pairs (e, 2) int32 of different numbers below `count`, each once, the lower number first, sorted."""
    return directed_pairs(one, other, count)[0]


def directed_pairs(one: np.ndarray, other: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """As `unique_pairs`, and for each pair whether it was given in both directions (e,) bool."""
    lower = np.minimum(one, other)
    bounds = np.linspace(0, count, PARTS + 1).astype(np.int64)
    parts = []
    for low, high in pairwise(bounds):
        part = np.flatnonzero((lower >= low) & (lower < high)).astype(np.int32)
        parts.append(_pairs(one[part], other[part], count))
    pairs, both = zip(*parts, strict=True)
    return np.concatenate(pairs), np.concatenate(both)


def _pairs(one: np.ndarray, other: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    apart = one != other
    keys = np.minimum(one, other)[apart].astype(np.int64)
    keys *= count
    keys += np.maximum(one, other)[apart]
    keys *= 2
    keys += (one > other)[apart]
    keys.sort()
    first = np.ones(len(keys), bool)
    np.not_equal(keys[1:] >> 1, keys[:-1] >> 1, out=first[1:])
    starts = np.flatnonzero(first)
    ends = np.append(starts[1:], len(keys))[: len(starts)] - 1
    both = (keys[starts] ^ keys[ends]) & 1 > 0
    keys = keys[starts] >> 1
    return np.stack([keys // count, keys % count], axis=1).astype(np.int32), both


def curve_keys(points: np.ndarray) -> np.ndarray:
    """Places (n,) uint64 of points (n, 3), in the unit frame, on a curve that keeps neighbors near (Morton 1966)."""
    cells = np.clip((points + 0.5) * 1024, 0, 1023).astype(np.uint64)
    key = np.zeros(len(points), np.uint64)
    for bit in range(10):
        for axis in range(3):
            key |= ((cells[:, axis] >> np.uint64(bit)) & np.uint64(1)) << np.uint64(3 * bit + axis)
    return key
