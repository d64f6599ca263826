"""The house that ARCHITECTURE.md describes: rooms that know lower ones only, and none too full."""

import ast
import re
from collections import Counter
from pathlib import Path

import pytest

from tests import imports

ROOT = Path(__file__).parents[1]
FULL = 14  # modules in a folder


@pytest.fixture(scope="module")
def graph():
    return imports.arrows(ROOT)


def test_no_module_imports_itself_by_way_of_others(graph):
    assert imports.cycles(graph) == []


def test_no_room_knows_a_higher_one(graph):
    assert imports.upward(graph) == []


def test_no_folder_is_too_full():
    assert {name: count for name, count in imports.sizes(ROOT).items() if count > FULL} == {}


def test_a_class_name_means_one_thing():
    names = Counter(
        node.name
        for path in imports.modules(ROOT).values()
        for node in ast.parse(path.read_text("utf-8")).body
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_")
    )
    assert [name for name, count in names.items() if count > 1] == []


def test_pictures_are_opened_by_python():
    """Mitsuba takes a path's letters for those of the code page on Windows: see `variants.read_bitmap`."""
    found = [
        str(path)
        for path in sorted((ROOT / "holopath_addon").rglob("*.py"))
        if re.search(r"Bitmap\(str\(|\)\.write\(str\(", path.read_text("utf-8"))
    ]
    assert found == []


def test_what_it_would_find(tmp_path):
    """A cycle, an arrow up to the planner that is for types alone, and a name that a package hands on."""
    files = {
        "engine/__init__.py": "from .scene.rays import Rays",
        "engine/scene/__init__.py": "",
        "engine/scene/rays.py": "if TYPE_CHECKING:\n    from ..planning.planner import Plan",
        "engine/planning/__init__.py": "",
        "engine/planning/planner.py": "def plan():\n    from .. import errors\n    from .pilot import Pilot",
        "engine/planning/pilot.py": "from . import planner",
        "engine/errors.py": "from .. import cli",
        "export/__init__.py": "from .. import engine",
        "slm/__init__.py": "from ..export import scene",
        "workflow/__init__.py": "from ..slm import errors\nfrom ..slm import sequence",
        "slm/errors.py": "",
        "slm/sequence.py": "",
        "export/scene.py": "from ..engine.scene import rays",
        "cli/__init__.py": "",
    }
    for name, text in files.items():
        path = tmp_path / imports.PACKAGE / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    graph, engine = imports.arrows(tmp_path), f"{imports.PACKAGE}.engine"
    assert imports.cycles(graph) == [[f"{engine}.planning.pilot", f"{engine}.planning.planner"]]
    assert imports.upward(graph) == [
        f"{engine}.errors imports {imports.PACKAGE}.cli",
        f"{engine}.scene.rays imports {engine}.planning.planner",
        f"{imports.PACKAGE}.slm imports {imports.PACKAGE}.export.scene",
        f"{imports.PACKAGE}.workflow imports {imports.PACKAGE}.slm.sequence",
    ]
    assert imports.sizes(tmp_path)[f"{imports.PACKAGE}/engine/planning"] == 2
