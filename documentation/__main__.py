"""Pages from the code, and figures of the prose.

python -m documentation site              build/site; a warning is an error
python -m documentation pages             write the parts of README.md and docs/ that the code declares
python -m documentation prose [FILE ...]  how long sentences are, page by page
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
    case _:
        sys.exit(__doc__)
