"""Entry point of ``python -m holopath_addon`` and ``blender --background --python HERE/__main__.py -- ...``."""

import sys

if __package__:
    from .cli import main
else:  # run as a file: the package is named like its folder
    import importlib
    from pathlib import Path

    package = Path(__file__).resolve().parent
    sys.path.insert(0, str(package.parent))
    main = importlib.import_module(f"{package.name}.cli").main

sys.exit(main())
