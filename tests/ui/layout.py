"""A layout without a window: it takes what Blender's takes, refuses what that would complain of, and remembers it."""

from types import SimpleNamespace

import bpy

_FUNCTIONS = bpy.types.UILayout.bl_rna.functions
_PROPERTIES = bpy.types.UILayout.bl_rna.properties


class Context:
    """Blender's context, with what only a window has."""

    def __init__(self, scene):
        self.scene, self.engine = scene, "HOLOPATH"
        self.region = SimpleNamespace(width=400)
        self.preferences = SimpleNamespace(system=SimpleNamespace(ui_scale=1.0))

    def __getattr__(self, name):
        return getattr(bpy.context, name)


class Layout:
    """Layout that records what is drawn into it.

    Attributes
    ----------
    drawn : list of (str, dict)
        Each function called, with its arguments by name; those of inner layouts, too.
    """

    def __init__(self, context, drawn=None):
        self.__dict__.update(_context=context, drawn=[] if drawn is None else drawn)

    def __setattr__(self, name, value):
        prop = _PROPERTIES[name]
        assert not prop.is_readonly and (prop.type != "ENUM" or value in prop.enum_items), (name, value)

    def __getattr__(self, name):
        assert name in _FUNCTIONS, f"UILayout has no '{name}'"
        return lambda *values, **named: self._call(_FUNCTIONS[name], values, named)

    def _call(self, function, values, named):
        given = _arguments(function, values, named)
        self.drawn.append((function.identifier, given))
        if function.identifier == "prop":
            prop = given["data"].bl_rna.properties[given["property"]]
            assert given.get("index", -1) < getattr(prop, "array_length", 0)
        elif function.identifier == "template_list":
            self._rows(given)
        elif function.identifier in ("operator", "operator_enum"):
            return self._operator(given["operator"])
        inner = any(p.is_output and p.identifier == "layout" for p in function.parameters)
        return Layout(self._context, self.drawn) if inner else None

    def _operator(self, identifier):
        """Ask an operator of Python's whether it can run, as Blender does for each button; its settings."""
        module, name = identifier.split(".")
        cls = bpy.types.Operator.bl_rna_get_subclass_py(f"{module.upper()}_OT_{name}")
        if hasattr(cls, "poll"):
            cls.poll(self._context)
        return _Settings(getattr(getattr(bpy.ops, module), name).get_rna_type())

    def _rows(self, given):
        """Draw the rows of a list."""
        cls = getattr(bpy.types, given["listtype_name"])
        active, index = given["active_dataptr"], given["active_propname"]
        assert index in active.bl_rna.properties
        for number, item in enumerate(getattr(given["dataptr"], given["propname"])):
            cls.draw_item(None, self._context, self, given["dataptr"], item, 0, active, index, number)

    def all(self, function, argument):
        """Values of an argument in all calls of a function that have it."""
        return [given[argument] for name, given in self.drawn if name == function and argument in given]

    @property
    def words(self):
        """All labels, one after the other."""
        return " ".join(self.all("label", "text"))


class _Settings:
    """Properties of an operator, which the code that draws its button may set."""

    def __init__(self, kind):
        self.__dict__["_kind"] = kind

    def __setattr__(self, name, value):
        assert name in self._kind.properties, f"{self._kind.identifier} has no '{name}'"


def _arguments(function, values, named):
    """The arguments by name, if Blender takes them."""
    inputs = {p.identifier: p for p in function.parameters if not p.is_output}
    given = dict(zip(inputs, values, strict=False)) | named
    required = {name for name, p in inputs.items() if p.is_required}
    assert len(values) <= len(inputs) and required <= set(given) <= set(inputs), (function.identifier, given)
    for name, value in given.items():
        kind = inputs[name].type
        if kind == "STRING":
            assert isinstance(value, str), (function.identifier, name, value)
        elif kind in ("INT", "FLOAT"):
            assert isinstance(value, int | float), (function.identifier, name, value)
        elif kind == "ENUM":
            assert value in inputs[name].enum_items, (function.identifier, name, value)
    return given


def draw(cls, context, method="draw"):
    """The `Layout` that a panel, a menu or the preferences have drawn; empty where it is not shown."""
    layout = Layout(context)
    if hasattr(cls, "poll") and not cls.poll(context):
        return layout
    members = {"layout": layout, "bl_rna": cls.bl_rna}
    for part in cls.__mro__:  # without Blender's own classes, of which it alone makes instances
        if part is not object and part is not bpy.types.bpy_struct and "bpy_types" not in part.__module__:
            members = {k: v for k, v in vars(part).items() if not k.startswith("__")} | members
    getattr(type(cls.__name__, (), members)(), method)(context)
    return layout
