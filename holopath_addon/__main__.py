"""``python -m holopath_addon``, or ``blender --background --python HERE/__main__.py -- ...``."""

import sys

if __package__:
    from .cli import main
else:  # run as a file: find the package by its folder's name
    import importlib
    from pathlib import Path

    package = Path(__file__).resolve().parent
    sys.path.insert(0, str(package.parent))
    main = importlib.import_module(f"{package.name}.cli").main

sys.exit(main())
