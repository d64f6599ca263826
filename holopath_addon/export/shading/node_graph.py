"""Traversal of Blender's node trees, through groups, reroutes and muted nodes."""

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
    """Find the output that feeds an input socket.

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
    waiting, visited = [pin], set()
    while waiting:
        source = follow(waiting.pop())
        if source.socket.is_output and source not in visited:
            visited.add(source)
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


def all_nodes(owner):
    """Yield every node of a material or tree, those within its groups too; of a group once, however often it is used.

    Parameters
    ----------
    owner : bpy.types.Material or bpy.types.NodeTree
    """
    waiting, visited = [getattr(owner, "node_tree", owner)], set()
    while waiting:
        tree = waiting.pop()
        if tree is None or tree in visited:
            continue
        visited.add(tree)
        for node in tree.nodes:
            yield node
            if node.bl_idname == "ShaderNodeGroup":
                waiting.append(node.node_tree)


def attributes_read(owner, kind):
    """Names that Attribute nodes of a type read, such as ``"INSTANCER"``.

    Parameters
    ----------
    owner : bpy.types.Material or bpy.types.NodeTree
    kind : str

    Returns
    -------
    set of str
    """
    nodes = (node for node in all_nodes(owner) if node.bl_idname == "ShaderNodeAttribute")
    return {node.attribute_name for node in nodes if node.attribute_type == kind}


# Textures that read generated coordinates where nothing is linked to their Vector.
GENERATED_BY_DEFAULT = {
    f"ShaderNodeTex{name}"
    for name in ("Noise", "Voronoi", "Wave", "Magic", "Gradient", "Checker", "Brick", "Gabor", "Musgrave")
}


def reads_generated(owner):
    """Whether nodes of a material read generated coordinates.

    Parameters
    ----------
    owner : bpy.types.Material or bpy.types.NodeTree
    """
    return any(_reads_generated(node) for node in all_nodes(owner))


def _reads_generated(node):
    kind = node.bl_idname
    if kind == "ShaderNodeTexCoord":
        return node.outputs["Generated"].is_linked and not node.from_instancer
    return kind in GENERATED_BY_DEFAULT and not node.inputs["Vector"].is_linked


# Outputs that differ from instance to instance of a mesh.
_INSTANCE_OUTPUTS = {
    "ShaderNodeObjectInfo": {"Location", "Color", "Alpha", "Object Index", "Random"},
    "ShaderNodeNewGeometry": {"Position", "Normal", "Tangent", "True Normal", "Incoming", "Backfacing"},
    "ShaderNodeTexCoord": {"Camera", "Window", "Reflection"},
    "ShaderNodeCameraData": {"View Vector", "View Z Depth", "View Distance"},
}


def reads_instance(owner):
    """Whether nodes of a material read values that differ between instances of a mesh, such as their place.

    Parameters
    ----------
    owner : bpy.types.Material or bpy.types.NodeTree
    """
    return any(_reads_instance(node) for node in all_nodes(owner))


def _reads_instance(node):
    kind = node.bl_idname
    if kind == "ShaderNodeAttribute":
        return node.attribute_type in ("OBJECT", "INSTANCER")
    if kind == "ShaderNodeVectorTransform":
        return {node.convert_from, node.convert_to} != {"OBJECT"}
    if kind in ("ShaderNodeTexEnvironment", "ShaderNodeTexSky"):  # by direction, in the world
        return True
    if getattr(node, "from_instancer", False):
        return True
    if kind == "ShaderNodeTexCoord" and node.object is not None and node.outputs["Object"].is_linked:
        return True
    if kind == "ShaderNodeNormalMap":
        return "WORLD" in node.space
    read = _INSTANCE_OUTPUTS.get(kind, set())
    return any(socket.is_linked and socket.name in read for socket in node.outputs)


def _passed_through(node, source):
    if node.bl_idname == "NodeReroute":
        return node.inputs[0]
    return next((link.from_socket for link in node.internal_links if link.to_socket == source), None)


def by_identifier(sockets, identifier) -> Any:
    """The socket of an identifier, or None."""
    return next((socket for socket in sockets if socket.identifier == identifier), None)


def tree_of(owner) -> Any:
    """Node tree of a new material or world, which older Blenders create on request."""
    if owner.node_tree is None:
        owner.use_nodes = True
    return owner.node_tree


def uses_nodes(owner):
    """Whether a material or world uses its nodes."""
    import bpy

    return bpy.app.version >= (5, 0, 0) or owner.use_nodes  # always true, and deprecated, since 5.0


def group_output(tree) -> Any:
    """The active output node of a group's tree, or None."""
    return next((n for n in tree.nodes if n.bl_idname == "NodeGroupOutput" and n.is_active_output), None)


def output_node(tree):
    """The active output node that Cycles would render, or None."""
    return tree.get_output_node("CYCLES") or tree.get_output_node("ALL")
