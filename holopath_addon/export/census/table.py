"""The table of the census, `table.toml`: the effect of each property of Blender's types that Cycles could read."""

import re
import tomllib
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import cache
from pathlib import Path

CARRIED, NOTED, WITHOUT = "carried", "noted", "without"


@dataclass(frozen=True)
class Name:
    """Name of a type or property, or a pattern of names, and the Blenders that have it.

    Attributes
    ----------
    pattern : str
    since, until : tuple of int
        The first version with it, and the first without.
    """

    pattern: str
    since: tuple = (0, 0)
    until: tuple = (99, 0)

    def matches(self, name):
        """Whether a name matches."""
        return fnmatchcase(name, self.pattern)

    def expected(self, version):
        """Whether a Blender of a version (a tuple) should have the property."""
        return self.since <= tuple(version[:2]) < self.until


@dataclass(frozen=True)
class Row:
    """Properties with the same effect.

    Attributes
    ----------
    names : tuple of Name
    status : str
        `CARRIED`, `NOTED` or `WITHOUT` effect.
    words : str
        Of a note, its feature or effect; of what has no effect, the reason.
    effect : str
        Of a note that `add_notes` gives; else empty.
    when : str
        Which values that note is for, see `table.toml`.
    """

    names: tuple
    status: str
    words: str = ""
    effect: str = ""
    when: str = ""


@dataclass(frozen=True)
class Section:
    """The rows of one or more types.

    Attributes
    ----------
    title : str
    types : tuple of Name
    rows : tuple of Row
    of_nodes : bool
        Whether the types are nodes.
    """

    title: str
    types: tuple
    rows: tuple
    of_nodes: bool


@cache
def sections():
    """All sections of the table."""
    table = tomllib.loads(Path(__file__).with_suffix(".toml").read_text("utf-8"))
    reasons, nodes = table.pop("reasons"), table.pop("nodes")
    return tuple(
        _section(title, content, reasons, of_nodes)
        for part, of_nodes in ((table, False), (nodes, True))
        for title, content in part.items()
    )


def _section(title, content, reasons, of_nodes):
    rows = []
    if CARRIED in content:
        rows.append(Row(_names(content[CARRIED]), CARRIED))
    for words, of in content.get(NOTED, {}).items():
        more = {"of": of} if isinstance(of, str) else of
        rows.append(Row(_names(more["of"]), NOTED, words, more.get("effect", ""), more.get("when", "")))
    rows += (Row(_names(of), WITHOUT, reasons[reason]) for reason, of in content.get(WITHOUT, {}).items())
    types = _names(content.get("of", title))
    return Section(types[0].pattern if "of" not in content else title, types, tuple(rows), of_nodes)


def _names(text):
    found = (re.fullmatch(r"(.+?)(?:>=(\d+)\.(\d+))?(?:<(\d+)\.(\d+))?", word) for word in text.split())
    return tuple(
        Name(name, (int(a or 0), int(b or 0)), (int(c or 99), int(d or 0)))
        for name, a, b, c, d in (match.groups() for match in found if match)
    )


@cache
def section_of(type_name):
    """The `Section` of a type by its name, or None."""
    return next((s for s in sections() if any(name.matches(type_name) for name in s.types)), None)


@cache
def row_of(type_name, property_name):
    """The `Row` of a property of a type, or None.

    Parameters
    ----------
    type_name : str
        That of the type that declares it, not of a derived one.
    property_name : str
    """
    section = section_of(type_name)
    rows = section.rows if section else ()
    return next((row for row in rows if any(name.matches(property_name) for name in row.names)), None)


def add_notes(struct, owner, notes):
    """Add the table's notes on properties of a structure that are not at their default.

    Parameters
    ----------
    struct : bpy.types.bpy_struct or None
    owner : str
        Name for the notes.
    notes : Notes
    """
    if struct is None:
        return
    kind = struct.bl_rna.identifier
    if kind not in _checks:
        section = section_of(kind)
        _checks[kind] = [
            (row, name.pattern, prop.default if prop.type != "POINTER" else None)
            for row in (section.rows if section else ())
            for name in (row.names if row.effect else ())
            if (prop := struct.bl_rna.properties.get(name.pattern)) is not None  # else of another Blender
        ]
    for row, name, default in _checks[kind]:
        value = getattr(struct, name)
        if value != default and _counts(value, default, row.when):
            notes.add(owner, row.words, row.effect)


_checks = {}  # by the type's name, what `add_notes` looks at: row, property and default


def _counts(value, default, when):
    """Whether a row applies to a value that is not the default, see `table.toml`."""
    return not when or (
        value > default if when == "more" else value < default and (when == "less" or value > 0)
    )
