"""Values, colors and vectors of shader nodes, compiled to fields.

Which node does what stands in `node_arithmetic` and `node_textures`. Outputs that cannot be computed from the surface
alone (noise and other procedural textures, what depends on the view) are reported in `unsupported`, and the socket they
feed falls back to its own value. Where a node depends on the ray, it is taken as a ray of diffuse light meets it: Light
Path tells a diffuse bounce, Fresnel and Layer Weight give their mean over all directions. Normals and bump are ignored:
they do not change where diffuse light goes by more than the mesh tells.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import bpy

from .fields import Field, attribute, constant, convert
from .images import MAX_SIDE, ImageLibrary
from .node_arithmetic import ARITHMETIC
from .node_graph import Scope, base_type, find_input, follow
from .node_textures import TEXTURES

#: By node type: a function of `NodeInputs` and the output asked for, giving a field, or None where it cannot.
COMPILERS: dict[str, Callable[[NodeInputs, bpy.types.NodeSocket], Field | None]] = {**ARITHMETIC, **TEXTURES}


class ValueCompiler:
    """Turns what feeds a socket into a `Field`.

    Parameters
    ----------
    images : ImageLibrary
    backfacing : float
        What Geometry, Backfacing gives: 0 on the front of a surface, 1 on its back.
    is_world : bool
        Whether the tree belongs to a world, whose only coordinate is the direction.
    max_side : int
        Largest side of an image that is kept.
    background_strength : float or None
        Replaces the strength of Background nodes.
    """

    def __init__(
        self,
        images: ImageLibrary,
        backfacing: float = 0.0,
        is_world: bool = False,
        max_side: int = MAX_SIDE,
        background_strength: float | None = None,
    ) -> None:
        self.images = images
        self.backfacing = backfacing
        self.is_world = is_world
        self.max_side = max_side
        self.background_strength = background_strength
        self.unsupported: list[str] = []
        self._known: dict[tuple, Field | None] = {}
        self._open: set[tuple] = set()

    def compile(self, socket: bpy.types.NodeSocket, scope: Scope | None) -> Field:
        """The field of an input socket: (n, 1) for values, (n, 3) for colors and vectors."""
        source = follow(socket, scope)
        if source.node is None:
            field = _default(source.socket)
        else:
            field = self._output(source.node, source.output, source.scope)
            if field is None:
                return _default(socket)
        for before, after in pairwise(source.types):
            field = convert(field, before, after)
        return field

    def remember(self, key: tuple, make: Callable[[], Field | None]) -> Field | None:
        """Compile once per key. While a key is being made, asking for it again means a cycle and gives None."""
        if key in self._known:
            return self._known[key]
        if key in self._open:
            return None
        self._open.add(key)
        self._known[key] = make()
        self._open.remove(key)
        return self._known[key]

    def report(self, node: bpy.types.Node) -> None:
        """Note a node that could not be evaluated."""
        if node.bl_label not in self.unsupported:
            self.unsupported.append(node.bl_label)

    def _output(self, node, output, scope) -> Field | None:
        inputs = NodeInputs(self, node, scope)

        def make():
            compile_node = COMPILERS.get(node.bl_idname)
            field = compile_node(inputs, output) if compile_node and _is_number(output) else None
            if field is None:
                self.report(node)
            return field

        return self.remember((*inputs.key, output.identifier), make)


class NodeInputs:
    """The inputs of one node in one scope, as fields."""

    def __init__(self, compiler: ValueCompiler, node: bpy.types.Node, scope: Scope | None) -> None:
        self.compiler = compiler
        self.node = node
        self.scope = scope

    @property
    def key(self) -> tuple:
        """Identifies the node in its scope."""
        return (self.node.as_pointer(), self.scope.key if self.scope else ())

    def has(self, *names: str) -> bool:
        """Whether the node has such an input."""
        return find_input(self.node, *names) is not None

    def is_linked(self, *names: str) -> bool:
        """Whether anything feeds an input."""
        socket = find_input(self.node, *names)
        return socket is not None and follow(socket, self.scope).node is not None

    def get(self, *names: str, otherwise: float = 0.0) -> Field:
        """The field of an input socket; a constant where this version of Blender has no such socket."""
        socket = find_input(self.node, *names)
        return constant(otherwise) if socket is None else self.compiler.compile(socket, self.scope)

    def coordinates(self, *names: str, otherwise: str) -> Field:
        """A texture's coordinates: what feeds the socket, or else the attribute that such textures take."""
        if self.is_linked(*names):
            return self.get(*names)
        return attribute(('direction', "") if self.compiler.is_world else (otherwise, ""))


def _is_number(socket) -> bool:
    return base_type(socket) in ('VALUE', 'RGBA', 'VECTOR')


def _default(socket) -> Field:
    """What a socket holds where nothing feeds it."""
    if not _is_number(socket) or not hasattr(socket, "default_value"):
        return constant(0.0)
    if base_type(socket) == 'VALUE':
        return constant(float(socket.default_value))
    return constant(*[*socket.default_value, 0.0, 0.0][:3])
