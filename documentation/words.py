"""Habits of names and docstrings to lose, for `make lint`.

python -m documentation words FOLDER ...    a line for each; status 1 if there are any
"""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
# First words of docstrings that leave out the noun or verb.
OPENERS = frozenset(
    "of from in on at to by with without for as after before about above against among around behind below beside "
    "between into over since through under until upon within what which who whom those that where when how".split()
)
NAMES = {
    re.compile(r"(^|_)(most|least)(_|$)", re.I): "max_ or min_",
    re.compile(
        r"^_*(told|asked|wanted|said|foretold|seen)$", re.I
    ): "a noun: on_progress, request, target, estimate",
}


def habits(path: Path) -> Iterator[tuple[int, str]]:
    """Line and complaint of each habit in a module."""
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)):
            words = (ast.get_docstring(node) or "").split()
            if words and words[0].lower().strip(",:") in OPENERS:
                first = getattr(node, "lineno", 1)
                yield first, f"a docstring starts with '{words[0]}': start with a noun or a verb"
        for name in _names(node):
            for pattern, remedy in NAMES.items():
                if pattern.search(name):
                    yield getattr(node, "lineno", 1), f"the name {name}: take {remedy}"


def check(folders: list[str]) -> list[str]:
    """Complaints about all modules below folders."""
    paths = [path for folder in folders for path in sorted((ROOT / folder).rglob("*.py"))]
    return [
        f"{path.relative_to(ROOT)}:{line}: {text}" for path in paths for line, text in sorted(habits(path))
    ]


def _names(node):
    """Names that a node of the syntax tree introduces."""
    if isinstance(node, ast.arg):
        return (node.arg,)
    if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
        return (node.id,)
    if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
        return (node.attr,)
    return (node.name,) if isinstance(node, (ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)) else ()
