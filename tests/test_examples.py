"""The scripts of the gallery run, in small, and show what the page says of them."""

import re
import runpy
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[1]
EXAMPLES = {path.stem: path for path in sorted((ROOT / "examples").glob("*.py")) if path.stem != "pictures"}


def test_each_has_its_place_in_the_gallery():
    page = (ROOT / "docs" / "gallery.md").read_text("utf-8")
    told = re.findall(r"examples/(\w+)\.py\)", page)
    assert sorted(told) == sorted([*EXAMPLES, "pictures"])  # which they share
    shown = {path.stem: path for path in (ROOT / "docs" / "images" / "gallery").iterdir()}
    assert sorted(shown) == sorted(EXAMPLES)
    assert max(path.stat().st_size for path in shown.values()) < 1.5e6
    for path in EXAMPLES.values():
        assert 15 <= len(path.read_text("utf-8").splitlines()) <= 60


@pytest.fixture
def ran(backend, tmp_path, monkeypatch, capsys):
    """Runs a script at so many pixels, and gives what it printed and the picture that it wrote."""
    pytest.importorskip("bpy")
    images = pytest.importorskip("PIL.Image")

    def run(name, pixels):
        monkeypatch.syspath_prepend(ROOT / "examples")
        monkeypatch.setattr(sys, "argv", [name, str(tmp_path), str(pixels)])
        monkeypatch.delitem(sys.modules, "pictures", raising=False)
        runpy.run_path(str(EXAMPLES[name]), run_name="__main__")
        (picture,) = (path for path in tmp_path.glob(f"{name}.*") if path.suffix in (".png", ".webp"))
        return capsys.readouterr().out, np.asarray(images.open(picture).convert("RGB"), float)

    return run


@pytest.mark.slow
@pytest.mark.parametrize("name", EXAMPLES)
def test_runs(name, ran):
    told, picture = ran(name, 128 if name == "convex_mirror" else 64)
    assert min(picture.shape[:2]) >= 64 and picture.std() > 15
    if name == "convex_mirror":
        mirror, image, far = (float(value) for value in re.findall(r"contrast ([\d.]+)", told))
        assert image > 1.1 * max(mirror, far)
    elif name == "other_program":
        # 0.016 in so small a picture: refocusing pads fields as far as rays walk, and a sharp stop spreads light beyond
        assert max(float(value) for value in re.findall(r"by ([\d.e+-]+)", told)) < 0.025
