"""Picture files by their paths."""

import numpy as np
import pytest

from holopath_addon.engine.scene import variants


def test_names_have_any_letters(tmp_path):
    pixels = np.arange(12, dtype=np.uint8).reshape(3, 4)
    path = tmp_path / "Größe – 相位.png"
    variants.write_png(path, pixels)
    np.testing.assert_array_equal(np.array(variants.read_bitmap(path)), pixels)
    path.write_bytes(b"no picture")
    with pytest.raises(RuntimeError):
        variants.read_bitmap(path)
    with pytest.raises(FileNotFoundError):
        variants.read_bitmap(tmp_path / "none.png")
