"""Pages that are written from the code, between marks in the Markdown: commands, settings, figures of the chart."""

import argparse
import itertools
import re
from collections.abc import Callable, Iterator
from pathlib import Path

from holopath_addon import cli, engine
from holopath_addon.cli import options
from holopath_addon.engine.settings import DECLARED

from . import mitsuba_census

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
# A folder that is nobody's own, as help tells the reader's.
STORE = engine.BakeStore(Path("~/.cache/holopath"))


def write(path: Path) -> str:
    """A page's text with all its parts as the code has them now.

    Parameters
    ----------
    path : Path
        A Markdown page with marks ``<!-- NAME: make guide -->`` and ``<!-- end of NAME -->``.

    Returns
    -------
    str
    """
    text = path.read_text("utf-8")
    for name, part in PARTS.items():
        begin, end = f"<!-- {name}: make guide -->", f"<!-- end of {name} -->"
        pattern = f"(?s)(?<={re.escape(begin)}\n\n).*(?=\n\n{re.escape(end)})"
        text = re.sub(pattern, lambda _, part=part: part(), text)
    return text


def parsers() -> dict[str, argparse.ArgumentParser]:
    """The parser of each command, by its name."""
    (commands,) = (
        action for action in cli._parser(STORE)._actions if isinstance(action, argparse._SubParsersAction)
    )
    hidden = {action.dest for action in commands._choices_actions}
    return {name: parser for name, parser in commands.choices.items() if name in hidden}


def commands() -> str:
    """All commands with their words and options."""
    text = "\n\n".join(_command(name, parser) for name, parser in parsers().items())
    return re.sub(r"docs/([\w-]+\.md)", r"[\1](\1)", text)


def _command(name, parser):
    positional = " ".join(_value(action) for action in parser._actions if not action.option_strings)
    text = [
        f"## {name}",
        f"```\nholopath {name} {positional}".rstrip() + " [options]\n```",
        parser.description,
    ]
    for group in parser._action_groups:
        rows = list(_rows(parser, group._group_actions))
        if not rows:
            continue
        title = "" if group.title in ("positional arguments", "options") else f"{_upper(group.title)}:\n\n"
        heading = "word" if group.title == "positional arguments" else "option"
        text.append(title + "\n".join([f"| {heading} | meaning |", "|---|---|", *rows]))
    return "\n\n".join(text)


def _rows(parser, actions) -> Iterator[str]:
    told, has_settings = False, DECLARED.keys() <= {action.dest for action in parser._actions}
    for action in actions:
        if action.help == argparse.SUPPRESS or action.dest in ("help", "quiet", "debug"):
            continue
        if has_settings and action.dest in DECLARED:
            if not told:
                flags = ", ".join(f"`{options.flag(name)}`" for name in DECLARED)
                yield f"| {flags} | how a hologram is computed: see [settings](settings.md) |"
            told = True
            continue
        words = " ".join(filter(None, [", ".join(action.option_strings), _value(action)]))
        meaning = parser._get_formatter()._expand_help(action)
        if action.choices and not action.metavar:
            meaning += f" ({', '.join(f'`{choice}`' for choice in action.choices)})"
        yield "| `{}` | {} |".format(*(text.replace("|", "\\|") for text in (words, meaning)))


def _value(action):
    if action.nargs == 0:
        return ""
    value = action.metavar or ("NAME" if action.choices else action.dest.upper())
    return {"?": f"[{value}]", "+": f"{value} [{value}]"}.get(action.nargs, str(value))


def _upper(text):
    first = text.partition(" ")[0]
    return (
        text
        if any(c.isupper() or not c.isalpha() for c in first.rstrip(",:;"))
        else text[:1].upper() + text[1:]
    )


def chart_table() -> str:
    """The part of the chart's table of methods that readers ask for first, and when it was measured."""
    text = (DOCS / "chart.md").read_text("utf-8")
    return f"{_chart_rows(text)}\n\n{_chart_made(text)}"


def _chart_made(text):
    """Days and commits of the chart's records, and its scenes, in a sentence.

    Records that were renewed later are of few frames, and not in that table.
    """
    text = "\n".join(line for line in text.splitlines() if "seconds divided by" not in line)
    made = dict.fromkeys(re.findall(r"(\d{4}-\d\d-\d\d)(?:, commit | \| )([0-9a-f]{7,})", text))
    scenes = re.findall(r"(?m)^\*\*(\w+)\*\*, ", text)
    days = " and ".join(f"{day} (commit {commit})" for day, commit in made)
    return f"*Measured on {days}: {', '.join(scenes)}.*"


def _chart_rows(text):
    _, _, table = text.partition("## The paper's Table 1, measured")
    lines = itertools.takewhile(lambda line: line[:1] == "|", table[table.index("\n|") + 1 :].splitlines())
    head, _, *rows = ([cell.strip() for cell in line.strip("| ").split("|")] for line in lines)
    body = {row[0]: row for row in rows}
    wanted = ("fast", "reflection", "material", "view", "between", "out of focus")
    columns = [next(n for n, title in enumerate(head) if part in title) for part in wanted]
    lines = [
        "| " + " | ".join(["method", "light", "seconds", *CHART_COLUMNS]) + " |",
        "|---" * (len(wanted) + 2) + "|",
    ]
    for name, told in CHART_METHODS.items():
        if name in body:  # others were not measured
            light = "phases" if name in CHART_PHASES else "field"
            lines.append("| " + " | ".join([told, light, *(body[name][n] for n in columns)]) + " |")
    return "\n".join(lines)


CHART_COLUMNS = (
    "mirrors, glass",
    "materials, indirect light",
    "views to the side",
    "between the depths",
    "out of focus",
)
CHART_METHODS = {
    "auto": "**HoloPath**, defaults",
    "paper": "the paper's estimator",
    "point": "point cloud",
    "polygon": "polygons",
    "rgbd": "layers of a picture with depth",
    "rgbd-torchoptics": "the same, by torchoptics",
    "gaussian": "Gaussians",
    "stereogram": "stereogram",
    "rgbd-sgd": "phases from a picture with depth",
    "focal-stack": "phases from a focal stack",
    "light-field": "phases from a light field",
}
CHART_PHASES = frozenset({"rgbd-sgd", "focal-stack", "light-field"})  # those of the others are complex fields


def decisions() -> str:
    """What `--fix` takes."""
    rows = (f"| `{name}` | {low} to {high} | {told} |" for name, (low, high, told) in engine.FIXABLE.items())
    return "\n".join(["| name | value | what |", "|---|---|---|", *rows])


def carried() -> str:
    """What becomes of each property of Blender's types, by the exporter's census."""
    from holopath_addon.export import census

    titles = {census.CARRIED: "carried", census.NOTED: "noted", census.WITHOUT: "no effect"}
    text = []
    for of_nodes, heading in ((False, "## Data-blocks and settings"), (True, "## Shader nodes")):
        text.append(heading)
        for section in census.sections():
            if section.of_nodes == of_nodes and section.rows:
                rows = ["| what becomes of it | which |", "|---|---|"]
                for row in section.rows:
                    words = row.words.replace("{}", "…")
                    told = f"“{words}”" if row.status == census.NOTED else words
                    rows.append(
                        f"| {': '.join(filter(None, [titles[row.status], told]))} | {_those(row.names)} |"
                    )
                kinds = (
                    [] if [n.pattern for n in section.types] == [section.title] else [_those(section.types)]
                )
                text += [f"### {section.title}", *kinds, "\n".join(rows)]
    return "\n\n".join(text)


def _those(names):
    """Names of a census, for a table."""
    told = []
    for name in names:
        since = [f"since {_version(name.since)}"] if name.since > (0, 0) else []
        until = [f"before {_version(name.until)}"] if name.until < (99, 0) else []
        pattern = {"*": "all"}.get(name.pattern, f"`{name.pattern}`")
        told.append(" ".join([pattern, *([f"({', '.join(since + until)})"] if since + until else [])]))
    return ", ".join(told)


def _version(version):
    return ".".join(map(str, version))


PARTS: dict[str, Callable[[], str]] = {
    "settings": options.guide_table,
    "commands": commands,
    "decisions": decisions,
    "chart": chart_table,
    "mitsuba": mitsuba_census.table,
    "mitsuba-reasons": mitsuba_census.reasons,
    "carried": carried,
}
