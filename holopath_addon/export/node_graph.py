"""Walking Blender's node trees: which output feeds a socket, through groups, reroutes and muted nodes."""

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Pin:
    """A socket together with the group nodes that were entered to reach it, outermost first."""

    socket: Any  # bpy.types.NodeSocket, which has a value of its own kind
    groups: tuple = ()

    @property
    def node(self):
        """The node the socket belongs to."""
        return self.socket.node

    def input(self, name):
        """Input socket `name` of the same node, or None where this Blender version has none."""
        socket = self.node.inputs.get(name)
        return None if socket is None else Pin(socket, self.groups)


def follow(pin):
    """Find where the value of an input socket comes from.

    Parameters
    ----------
    pin : Pin
        An input socket.

    Returns
    -------
    Pin
        The output socket that feeds it, or the input socket (of this node or of an outer group node)
        whose own value counts because nothing is linked to it. Where the links run in a circle, the output
        socket at which that shows.
    """
    passed = set()
    while True:
        link = first_link(pin.socket)
        if link is None:
            return pin
        source, node = link.from_socket, link.from_node
        beyond, groups = None, pin.groups
        if node.mute or node.bl_idname == "NodeReroute":
            beyond = _passed_through(node, source)
        elif node.bl_idname == "NodeGroupInput" and groups:
            beyond, groups = by_identifier(groups[-1].inputs, source.identifier), groups[:-1]
        elif node.bl_idname == "ShaderNodeGroup" and node.node_tree is not None:
            output = group_output(node.node_tree)
            if output is not None and node not in groups:  # else a group inside itself
                beyond, groups = by_identifier(output.inputs, source.identifier), (*groups, node)
        if beyond is None or pin in passed:
            return Pin(source, pin.groups)
        passed.add(pin)
        pin = Pin(beyond, groups)


def first_link(socket):
    """The link that feeds an input socket, or None."""
    return next((link for link in socket.links if link.is_valid and not link.is_muted), None)


def upstream(pin):
    """Yield every output socket that an input socket's value comes from, through groups and reroutes.

    Parameters
    ----------
    pin : Pin
    """
    waiting, seen = [pin], set()
    while waiting:
        source = follow(waiting.pop())
        if source.socket.is_output and source not in seen:
            seen.add(source)
            yield source
            waiting += [Pin(socket, source.groups) for socket in source.node.inputs]


def alphas_upstream(*pins):
    """Alpha outputs of Image Textures that input sockets depend on: Cycles divides the color by those.

    Parameters
    ----------
    *pins : Pin

    Returns
    -------
    set of Pin
    """
    sources = (source for pin in pins for source in upstream(pin))
    return {s for s in sources if s.node.bl_idname == "ShaderNodeTexImage" and s.socket.name == "Alpha"}


def _passed_through(node, source):
    if node.bl_idname == "NodeReroute":
        return node.inputs[0]
    return next((link.from_socket for link in node.internal_links if link.to_socket == source), None)


def by_identifier(sockets, identifier) -> Any:
    """The socket of an identifier, or None."""
    return next((socket for socket in sockets if socket.identifier == identifier), None)


def tree_of(owner) -> Any:
    """The node tree of a new material or world, which older Blenders make when asked."""
    if owner.node_tree is None:
        owner.use_nodes = True
    return owner.node_tree


def uses_nodes(owner):
    """Whether a material or world is what its nodes make of it."""
    import bpy

    return bpy.app.version >= (5, 0, 0) or owner.use_nodes  # always true, and deprecated, since 5.0


def group_output(tree) -> Any:
    """The active output node of a group's tree, or None."""
    return next((n for n in tree.nodes if n.bl_idname == "NodeGroupOutput" and n.is_active_output), None)


def output_node(tree):
    """The active output node that Cycles would render, or None."""
    return tree.get_output_node("CYCLES") or tree.get_output_node("ALL")
