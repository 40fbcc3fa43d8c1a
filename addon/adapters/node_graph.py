"""Ways through a node tree: what feeds a socket, past reroutes, muted nodes and groups.

`follow` ends at a node that computes something, or at a socket that nothing feeds. Limits: outputs of zones (repeat,
closure) are not followed and end as the node that they are.
"""

from __future__ import annotations

from dataclasses import dataclass

import bpy

#: Links followed in a row before a chain is taken for endless. Blender marks cycles invalid, so this is a second guard.
MAX_LINKS = 10_000

#: Whether the sockets at a group's border convert what passes. From 5.0 Blender dissolves groups before it renders, and
#: a color goes through a group's value input unchanged.
CONVERTS_AT_BORDERS = bpy.app.version < (5, 0)


@dataclass(frozen=True)
class Scope:
    """Where a node tree is used: the group node that holds it, and that node's own scope."""

    group: bpy.types.Node
    parent: Scope | None

    @property
    def key(self) -> tuple[int, ...]:
        """Identifies this use of the tree."""
        return ((*self.parent.key,) if self.parent else ()) + (self.group.as_pointer(),)


@dataclass(frozen=True)
class Source:
    """What feeds a socket.

    Parameters
    ----------
    node, output : bpy.types.Node, bpy.types.NodeSocket or None
        The node that computes, and which of its outputs; None where nothing is linked.
    socket : bpy.types.NodeSocket
        The last socket on the way, whose default counts where nothing is linked.
    scope : Scope or None
        Of `node`.
    types : tuple of str
        Socket types on the way from the source to the socket asked for; each step converts.
    """

    node: bpy.types.Node | None
    output: bpy.types.NodeSocket | None
    socket: bpy.types.NodeSocket
    scope: Scope | None
    types: tuple[str, ...]


def base_type(socket: bpy.types.NodeSocket) -> str:
    """The socket's type, with all single numbers as ``VALUE``."""
    return 'VALUE' if socket.type in ('INT', 'BOOLEAN') else socket.type


def follow(socket: bpy.types.NodeSocket, scope: Scope | None) -> Source:
    """Find what feeds an input socket."""
    types = [base_type(socket)]
    default = socket
    for _ in range(MAX_LINKS):
        link = next((each for each in socket.links if each.is_valid and not each.is_muted), None)
        if link is None:
            return _open_end(default, scope, types)
        node, output = link.from_node, link.from_socket
        following = _next_input(node, output, scope)
        if following is None:
            types.append(base_type(output))
            return Source(node, output, default, scope, tuple(reversed(types)))
        socket, scope = following
        if socket is None:
            return _open_end(default, scope, types)
        if node.bl_idname != 'NodeReroute':  # an open reroute counts as no link at all
            default = socket
            if CONVERTS_AT_BORDERS:
                types.append(base_type(socket))
    return _open_end(default, scope, types)


def _open_end(default, scope, types) -> Source:
    """A way that ends at a socket's own value, which converts too."""
    if types[-1] != base_type(default):
        types = [*types, base_type(default)]
    return Source(None, None, default, scope, tuple(reversed(types)))


def _next_input(node, output, scope):
    """The input (with its scope) that an output only passes on; None where the node itself computes.

    The input is None where the way ends inside: a group without output, a muted node without a way through.
    """
    if node.bl_idname == 'NodeReroute':
        return node.inputs[0], scope
    if node.mute:
        inner = next((link for link in node.internal_links if link.to_socket == output), None)
        return (inner.from_socket if inner else None), scope
    if node.bl_idname == 'NodeGroupInput':
        if scope is None:
            return None, None
        return _by_identifier(scope.group.inputs, output.identifier), scope.parent
    tree = getattr(node, "node_tree", None)
    if node.bl_idname == 'ShaderNodeGroup' or (tree is not None and node.bl_idname.endswith('NodeGroup')):
        if tree is None:
            return None, scope
        ends = [each for each in tree.nodes if each.bl_idname == 'NodeGroupOutput']
        end = next((each for each in ends if each.is_active_output), None)
        return (_by_identifier(end.inputs, output.identifier) if end else None), Scope(node, scope)
    return None


def _by_identifier(sockets, identifier: str):
    return next((socket for socket in sockets if socket.identifier == identifier), None)


def find_input(node: bpy.types.Node, *names: str):
    """An input socket by identifier or name, the first that exists and is in use; None without any.

    Nodes with a data type (Mix, ...) hold sockets of one name for every type, of which only the identifier differs.
    """
    for name in names:
        for socket in node.inputs:
            if socket.identifier == name or (socket.name == name and socket.enabled):
                return socket
    return None
