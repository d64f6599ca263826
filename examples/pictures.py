"""What the examples share: where pictures go, and how linear light becomes a picture on a monitor."""

import io
import sys
from pathlib import Path

import numpy as np
from PIL import Image

from holopath_addon.workflow import output


def asked(example, pixels=256):
    """Folder and pixels a side that the command line asks for: `python examples/NAME.py [FOLDER] [PIXELS]`."""
    name = Path(example).stem
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else f"out/examples/{name}")
    folder.mkdir(parents=True, exist_ok=True)
    return folder / name, int(sys.argv[2]) if len(sys.argv) > 2 else pixels


def shown(images):
    """Pictures for a monitor of linear ones [picture, y, x, color], all with the same exposure."""
    white = output.exposure(np.asarray(images))
    return [Image.open(io.BytesIO(output.encode_png(image, white))) for image in images]


def save_rows(path, *rows):
    """Rows of pictures as one PNG."""
    lines = [np.concatenate([np.asarray(picture) for picture in row], axis=1) for row in rows]
    Image.fromarray(np.concatenate(lines)).save(path.with_suffix(".png"))


def save_loop(path, pictures, milliseconds=100):
    """Pictures there and back as an animated WebP, which any browser shows."""
    there_and_back = [*pictures, *pictures[-2:0:-1]]
    there_and_back[0].save(
        path.with_suffix(".webp"),
        save_all=True,
        append_images=there_and_back[1:],
        duration=milliseconds,
        loop=0,
        quality=70,
        method=6,
    )
