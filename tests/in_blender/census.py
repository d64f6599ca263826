"""Walks the types and nodes of the Blender that runs it, and compares them with the exporter's census.

    blender --background --factory-startup --python census.py

Prints what the census lacks and what it has too much, then the counts; the status is 1 where the two differ.
"""

import contextlib
import importlib.util
import os
import sys
from collections import Counter
from pathlib import Path

import bpy

# Blender's own types; Cycles' settings are those of `cycles_types`.
TYPES = """
    ID Object DepsgraphObjectInstance ObjectLightLinking CollectionChild CollectionObject CollectionLightLinking
    MaterialSlot Modifier SubsurfModifier MultiresModifier
    Mesh MeshUVLoopLayer AttributeGroupMesh Curve TextCurve SurfaceCurve MetaBall MetaElement Curves PointCloud
    Volume VolumeRender VolumeDisplay ParticleSettings ParticleSystem
    Light PointLight SpotLight SunLight AreaLight World WorldLighting WorldMistSettings
    Camera CameraDOFSettings CameraStereoData Material
    Collection LayerCollection ViewLayer Scene RenderSettings BakeSettings UnitSettings TimelineMarker
    ColorManagedViewSettings ColorManagedDisplaySettings ColorManagedInputColorspaceSettings
    ImageFormatSettings FFmpegSettings SceneDisplay SceneEEVEE
    Image ImageUser UDIMTile TexMapping ColorMapping NodeTree Node
""".split()
NODE_BASES = ("ShaderNode", "NodeInternal", "Node")
OTHER_NODES = ("Compositor", "Texture")


def of_addons(prop):
    """Whether an add-on has registered a property, so that Cycles knows nothing of it."""
    return prop.is_runtime


def own(struct, skipped):
    """Names of the properties that a type has, and its base has not."""
    inherited = {"rna_type"}
    if struct.base:
        inherited |= {prop.identifier for prop in struct.base.properties}
    return [p.identifier for p in struct.properties if p.identifier not in inherited and not skipped(p)]


def cycles_types():
    """Types of Cycles' own settings, which its add-on registers."""
    scene = bpy.context.scene
    blocks = [
        bpy.data.objects.new("census", None),
        bpy.data.lights.new("census", "POINT"),
        bpy.data.worlds.new("census"),
        bpy.data.materials.new("census"),
    ]
    groups = [block.cycles for block in (scene, scene.view_layers[0], *blocks)]
    return [type(group) for group in (*groups, scene.cycles_curves, blocks[2].cycles_visibility)]


def properties(skipped=of_addons):
    """Names of the properties of every type, without those of add-ons.

    Parameters
    ----------
    skipped : callable
        Whether a property (`bpy.types.Property`) does not count, of Blender's own types.

    Returns
    -------
    dict of str to list of str
    """
    found = {
        name: own(getattr(bpy.types, name).bl_rna, skipped) for name in TYPES if hasattr(bpy.types, name)
    }
    for kind in cycles_types():
        found[kind.bl_rna.identifier] = own(kind.bl_rna, lambda prop: False)
    return found


def nodes():
    """Names of the properties, and of the sockets as ``in.NAME`` and ``out.NAME``, of every node of shaders.

    Returns
    -------
    dict of str to list of str
    """
    trees = [
        bpy.data.node_groups.new("census", "ShaderNodeTree"),
        *(tree_of(block) for block in (bpy.data.materials, bpy.data.worlds)),
    ]
    found = {}
    for name in dir(bpy.types):
        kind = getattr(bpy.types, name)
        if name in NODE_BASES or name.startswith(OTHER_NODES):
            continue
        if not (isinstance(kind, type) and issubclass(kind, bpy.types.Node)):
            continue
        node = next(filter(None, (added(tree, name) for tree in trees)), None)
        if node is not None:
            common = {prop.identifier for prop in bpy.types.Node.bl_rna.properties}
            names = [p.identifier for p in node.bl_rna.properties if p.identifier not in common]
            for side, sockets in (("in", node.inputs), ("out", node.outputs)):
                names += (f"{side}.{socket.identifier.replace(' ', '_')}" for socket in sockets)
            found[name] = list(dict.fromkeys(names))
    return found


def tree_of(collection):
    """The tree of a new data-block, which older Blenders make when asked."""
    block = collection.new("census")
    if block.node_tree is None:
        block.use_nodes = True
    return block.node_tree


def added(tree, name):
    """A new node of a tree, or None where it takes none of this type."""
    try:
        return tree.nodes.new(name)
    except RuntimeError:
        return None


def lacking(census, found):
    """Properties of a Blender that the census lacks, as ``Type.name``."""
    return [
        f"{kind}.{name}"
        for kind, names in found.items()
        for name in names or ["*"]
        if (census.section_of(kind) if name == "*" else census.row_of(kind, name)) is None
    ]


def doubled(census, found):
    """Entries that the census has more than once."""
    wrong = []
    for kind, names in found.items():
        of_kind = [s for s in census.sections() if any(name.matches(kind) for name in s.types)]
        wrong += [kind] * (len(of_kind) > 1)
        for each in names:
            rows = [
                row for section in of_kind for row in section.rows if any(n.matches(each) for n in row.names)
            ]
            wrong += [f"{kind}.{each}"] * (len(rows) > 1)
    return wrong


def stale(census, found, version):
    """Names of the census that a Blender of this version should have, and has not."""
    wrong = []
    for section in census.sections():
        kinds = [kind for kind in found if census.section_of(kind) is section]
        wrong += (
            f"{section.title}: {name.pattern}"
            for name in section.types
            if name.expected(version) and not any(name.matches(kind) for kind in kinds)
        )
        if not any(name.expected(version) for name in section.types):
            continue
        wrong += (
            f"{section.title}: {name.pattern}"
            for row in section.rows
            for name in row.names
            if name.expected(version)
            and not any(name.matches(each) for kind in kinds for each in found[kind])
        )
    return wrong


def counts(census, of_types, of_nodes):
    """Lines of a table: types, properties and sockets by what becomes of them."""
    lines = [f"Blender {bpy.app.version_string}"]
    for title, found in (("properties of types", of_types), ("of nodes", of_nodes)):
        rows = Counter(
            (
                name.partition(".")[0] if name.startswith(("in.", "out.")) else "property",
                census.row_of(kind, name).status,
            )
            for kind, names in found.items()
            for name in names
        )
        summary = ", ".join(f"{what} {status} {count}" for (what, status), count in sorted(rows.items()))
        lines.append(f"{title}: {len(found)} types, {sum(rows.values())} names: {summary}")
    return lines


@contextlib.contextmanager
def silenced():
    """Keep to ourselves what Blender prints about each node that a tree does not take."""
    sys.stdout.flush()
    kept, nothing = [os.dup(1), os.dup(2)], os.open(os.devnull, os.O_WRONLY)
    try:
        for number in (1, 2):
            os.dup2(nothing, number)
        yield
    finally:
        for number, each in zip((1, 2), kept, strict=True):
            os.dup2(each, number)


def main():
    path = Path(__file__).parents[2] / "holopath_addon" / "export" / "census" / "table.py"
    spec = importlib.util.spec_from_file_location("census_table", path)
    census = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = census
    spec.loader.exec_module(census)
    with silenced():
        of_types, of_nodes = properties(), nodes()
    found = of_types | of_nodes
    wrong = [f"lacks {name}" for name in lacking(census, found)]
    wrong += (f"twice {name}" for name in doubled(census, found))
    wrong += (f"stale {name}" for name in stale(census, found, bpy.app.version))
    print(*wrong, sep="\n")
    if not wrong:
        print(*counts(census, of_types, of_nodes), sep="\n")
    sys.exit(bool(wrong))


if __name__ == "__main__":
    main()
