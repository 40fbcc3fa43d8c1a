"""Fields: values that vary over a surface, as small programs without any reference to Blender.

A `Field` is a constant, or a function of attributes (UV coordinates, vertex colors, ...) at many points at once. Node
trees are compiled to fields once; after that they can be evaluated between the ticks of a modal operator, from any
thread, and after the node tree has changed or gone.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from .mesh_arrays import AttributeKey

#: Share of the three primaries in luminance (Rec. 709), by which Blender turns a color into a value.
LUMINANCE = np.array([0.2126, 0.7152, 0.0722], dtype=np.float32)


class Samples:
    """The points at which fields are evaluated.

    Parameters
    ----------
    attributes : mapping of AttributeKey to (n, k) float32
    count : int
        Number of points n.
    """

    def __init__(self, attributes: Mapping[AttributeKey, np.ndarray], count: int) -> None:
        self.attributes = attributes
        self.count = count
        # A node that feeds many others is evaluated once. The field itself is the key, so that it stays alive.
        self.known: dict[Field, np.ndarray] = {}


class Field:
    """A value at points: call it with `Samples` to get (n, k) or, where nothing varies, (1, k) float32.

    Parameters
    ----------
    function : callable
        From `Samples` to the array.
    attributes : frozenset of AttributeKey
        What the samples must hold; empty means constant.
    """

    def __init__(self, function: Callable[[Samples], np.ndarray], attributes: frozenset[AttributeKey]) -> None:
        self.function = function
        self.attributes = attributes

    def __call__(self, samples: Samples) -> np.ndarray:
        if not self.attributes:  # costs nothing, and must not pile up in `NOWHERE`
            return self.function(samples)
        if self not in samples.known:
            samples.known[self] = self.function(samples)
        return samples.known[self]

    @property
    def constant(self) -> np.ndarray:
        """(k,) value of a constant field."""
        return self(NOWHERE)[0]


#: The samples that suffice for constants.
NOWHERE = Samples({}, 1)


def constant(*values: float) -> Field:
    """The same everywhere."""
    array = np.array([values], dtype=np.float32)
    array.flags.writeable = False
    return Field(lambda samples: array, frozenset())


def attribute(key: AttributeKey) -> Field:
    """An attribute as the samples hold it."""
    return Field(lambda samples: samples.attributes[key], frozenset([key]))


def combine(function: Callable[..., np.ndarray], *fields: Field) -> Field:
    """A function of the arrays of other fields; computed at once where all of them are constant."""
    attributes = frozenset().union(*(field.attributes for field in fields))
    if attributes:
        return Field(lambda samples: function(*(field(samples) for field in fields)), attributes)
    with np.errstate(all="ignore"):  # a division by zero is as legal in a constant as it is at a point
        array = np.asarray(function(*(field(NOWHERE) for field in fields)), dtype=np.float32)
    return Field(lambda samples: array, frozenset())


def as_value(color: Field) -> Field:
    """Luminance of a color."""
    return combine(lambda array: array @ LUMINANCE[:, None], color)


def convert(field: Field, source: str, target: str) -> Field:
    """From one type of node socket to another, as Blender does along a link: ``VALUE``, ``RGBA`` or ``VECTOR``."""
    if source == target or {source, target} == {'RGBA', 'VECTOR'}:
        return field
    if target == 'VALUE':
        return as_value(field) if source == 'RGBA' else combine(lambda array: array.mean(1, keepdims=True), field)
    return combine(lambda array: np.repeat(array, 3, axis=1), field)
