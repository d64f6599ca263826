"""The import graph of the package: who knows whom. `python tests/imports.py` prints its figures.

Imports within functions count, and those for types alone.
"""

from __future__ import annotations

import ast
import sys
from collections import Counter
from pathlib import Path

PACKAGE = "holopath_addon"
# Houses, and what they may know beside themselves: other houses, or modules of them.
HOUSES = {
    "engine": (),
    "slm": ("engine",),
    "export": ("engine",),
    "exchange": ("engine",),
    "workflow": ("engine", "slm.errors", "farm.errors"),  # whose sentences it tells
    "farm": ("engine", "workflow"),
    "cli": (
        *("engine", "slm", "exchange", "workflow", "farm", "export", "llvm_package"),
        *("blender.demo", "blender.properties"),
    ),
    "llvm_package": (),
}
# The engine's rooms from low to high: modules of one know those of lower ones, and of their own.
ROOMS = ("scene", "waves", "light", "tracing", "encoding", "planning", "viewing", "baselines")
TOP = "rendering"  # the module that knows all of them


def modules(root: Path) -> dict[str, Path]:
    """Path of each module by its dotted name; a package's is its `__init__`."""
    found = {}
    for path in sorted((root / PACKAGE).rglob("*.py")):
        parts = path.relative_to(root).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def arrows(root: Path) -> dict[str, set[str]]:
    """The modules that each module imports."""
    found = modules(root)
    return {name: {m for m in _imported(name, path, found) if m != name} for name, path in found.items()}


def _imported(name, path, found):
    package = name.split(".") if path.name == "__init__.py" else name.split(".")[:-1]
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if not isinstance(node, ast.ImportFrom):
            continue
        parts = package[: len(package) + 1 - node.level] if node.level else []
        base = ".".join([*parts, *([node.module] if node.module else [])])
        for alias in node.names:
            whole = f"{base}.{alias.name}"
            if whole in found or base in found:
                yield whole if whole in found else base


def cycles(graph: dict[str, set[str]]) -> list[list[str]]:
    """Groups of modules of which each, by way of others, imports itself (Tarjan's strongly connected components)."""
    index, low, stack, groups = {}, {}, [], []

    def visit(name):
        index[name] = low[name] = len(index)
        stack.append(name)
        for other in graph[name]:
            if other not in index:
                visit(other)
            if other in stack:
                low[name] = min(low[name], low[other])
        if low[name] == index[name]:
            group = stack[stack.index(name) :]
            del stack[stack.index(name) :]
            if len(group) > 1:
                groups.append(sorted(group))

    for name in graph:
        if name not in index:
            visit(name)
    return groups


def level(name: str) -> int:
    """How high an engine's module stands: nouns lowest, then the rooms, then the engine itself; -1 of others."""
    parts = name.split(".")
    if parts[:2] != [PACKAGE, "engine"]:
        return -1
    if len(parts) == 2 or parts[2] == TOP:
        return len(ROOMS) + 1
    return ROOMS.index(parts[2]) + 1 if parts[2] in ROOMS else 0


def upward(graph: dict[str, set[str]]) -> list[str]:
    """Arrows that go up within the engine, or out of a house to where it may not."""

    def astray(name, other):
        house = f"{name}.".split(".")[1]
        known = tuple(f"{PACKAGE}.{each}." for each in (house, *HOUSES.get(house, ())))
        leaves = house in HOUSES and not f"{other}.".startswith(known)
        return leaves or level(other) > level(name) >= 0

    return sorted(f"{name} imports {other}" for name in graph for other in graph[name] if astray(name, other))


def sizes(root: Path) -> Counter:
    """Modules in each folder, but for `__init__`."""
    paths = modules(root).values()
    return Counter(str(p.parent.relative_to(root)) for p in paths if p.name != "__init__.py")


if __name__ == "__main__":
    root = Path(sys.argv[1] if len(sys.argv) > 1 else Path(__file__).parents[1])
    graph = arrows(root)
    print(f"{len(graph)} modules, {sum(map(len, graph.values()))} arrows, {len(cycles(graph))} cycles")
    print(*(f"cycle: {', '.join(group)}" for group in cycles(graph)), sep="\n")
    print(f"{len(upward(graph))} arrows up")
    print("largest folders:", ", ".join(f"{name} {count}" for name, count in sizes(root).most_common(4)))
