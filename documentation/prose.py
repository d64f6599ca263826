"""How long the sentences of Markdown pages are.

python -m documentation prose [FILE ...]    a row for each page: sentences, median and longest in words, share over 35
"""

import re
import statistics
from collections.abc import Iterator
from pathlib import Path

from markdown_it import MarkdownIt
from markdown_it.token import Token
from mdit_py_plugins.dollarmath import dollarmath_plugin

ROOT = Path(__file__).parents[1]
LONG = 35  # words
LOGS = {"chart.md", "exporter.md"}  # figures, by the programs that measure them
_ENDS = re.compile(r"(?<=[.!?])[)\"”*_]*\s+(?=[^a-z\s])|:\s*\n|\n\n")
_ABBREVIATIONS = re.compile(r"\b(e\.g|i\.e|et al|Fig|Eq|eq|vs|No|cf|pp|Graph|Trans)\.")


def written() -> list[Path]:
    """The pages that people write for readers, from the checkout's folder."""
    top = [ROOT / name for name in ("README.md", "ARCHITECTURE.md", "CONTRIBUTING.md")]
    pages = [path for path in sorted((ROOT / "docs").rglob("*.md")) if path.name not in LOGS]
    return [path.relative_to(ROOT) for path in top + pages]


def sentences(markdown: str) -> list[str]:
    """The sentences of paragraphs and lists; tables, headings and code are none, and code or a formula is a word."""
    tokens = MarkdownIt().enable("table").use(dollarmath_plugin).parse(markdown)
    found = []
    for paragraph in _paragraphs(tokens):
        text = _ABBREVIATIONS.sub(r"\1", paragraph)
        found += [part.strip() for part in _ENDS.split(text) if part.strip()]
    return [sentence for sentence in found if words(sentence)]


def words(sentence: str) -> int:
    """Words of a sentence, which have a letter or a digit."""
    return sum(any(c.isalnum() for c in word) for word in sentence.split())


def table(paths: list[Path]) -> str:
    """A Markdown table of pages."""
    rows = ["| page | sentences | median | longest | over 35 words |", "|---|---|---|---|---|"]
    everything = []
    for path in paths:
        lengths = [words(sentence) for sentence in sentences(path.read_text("utf-8"))]
        everything += lengths
        rows.append(_row(str(path), lengths))
    return "\n".join([*rows, _row("all", everything)])


def _row(name, lengths):
    share = sum(length > LONG for length in lengths) / max(len(lengths), 1)
    median = statistics.median(lengths) if lengths else 0
    return f"| {name} | {len(lengths)} | {median:g} | {max(lengths, default=0)} | {share:.0%} |"


def _paragraphs(tokens: list[Token]) -> Iterator[str]:
    for before, token in zip(tokens, tokens[1:], strict=False):
        if before.type == "paragraph_open" and token.type == "inline":
            yield "".join(_text(child) for child in token.children or [])


def _text(token):
    if token.type in ("code_inline", "math_inline", "image"):
        return "Code" if token.type != "image" else ""
    return "\n" if token.type in ("softbreak", "hardbreak") else token.content
