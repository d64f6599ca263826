"""Pages from the code, figures of the prose, and the pictures.

python -m documentation site              build/site; a warning is an error
python -m documentation pages             write the parts of README.md and docs/ that the code declares
python -m documentation prose [FILE ...]  how long sentences are, page by page
python -m documentation words FOLDER ...  habits of names and docstrings to lose
python -m documentation pictures          remake the pictures of the window and of rendered scenes, in docs/images
python -m documentation pictures NAME ... remake these
python -m documentation pictures --all    remake all, benchmarks and examples included, which takes hours
python -m documentation pictures --list   each picture, and the command that makes it
python -m documentation sketches          remake the sketches of benches, in a second
"""

import sys
from pathlib import Path

from . import pages

match sys.argv[1:]:
    case ["pages"]:
        for path in (pages.ROOT / "README.md", *sorted(pages.DOCS.rglob("*.md"))):
            text = pages.write(path)
            if text != path.read_text("utf-8"):
                path.write_text(text, "utf-8")
                print(path.relative_to(pages.ROOT))
    case ["site"]:
        from . import site

        sys.exit(site.build(pages.ROOT / "build" / "site"))
    case ["prose", *names]:
        from . import prose

        print(prose.table([Path(name) for name in names] or prose.written()))
    case ["words", *folders]:
        from . import words

        complaints = words.check(folders)
        sys.exit("\n".join(complaints) or None)
    case ["pictures", *names]:
        from . import pictures as made

        if names == ["--list"]:
            print(made.table())
        elif names == ["--all"]:
            made.make(made.PICTURES)
        else:
            made.make(names or made.WINDOW | made.FILMED | made.RENDERED)
    case ["sketches"]:
        from . import sketches

        sketches.write()
    case _:
        sys.exit(__doc__)
