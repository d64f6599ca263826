"""Preferences of the add-on."""

import os

import pytest

from holopath_addon import cli
from holopath_addon.blender import preferences, registration


def test_where_baked_light_is_kept(monkeypatch, tmp_path):
    from types import SimpleNamespace

    monkeypatch.setattr(preferences, "_chosen", lambda: SimpleNamespace(bake_folder=str(tmp_path / "named")))
    assert preferences.store().folder == tmp_path / "named"
    monkeypatch.setattr(preferences, "_chosen", lambda: None)
    monkeypatch.setenv("HOLOPATH_CACHE", str(tmp_path))
    assert preferences.store().folder == tmp_path


@pytest.mark.parametrize(
    ("chosen", "given", "used"),
    [("cuda_ad_rgb", None, "cuda_ad_rgb"), (None, None, None), ("cuda_ad_rgb", "llvm_ad_rgb", "llvm_ad_rgb")],
)
def test_a_command_computes_with_what_is_chosen(monkeypatch, chosen, given, used):
    """Unless the variable names another one, which is given with the command."""
    seen = []
    monkeypatch.setattr(preferences, "chosen_backend", lambda: chosen)
    monkeypatch.setattr(cli, "main", lambda argv, store: seen.append(os.environ.get("HOLOPATH_BACKEND")))
    monkeypatch.setenv("HOLOPATH_BACKEND", given or "")  # so that it is put back
    if not given:
        monkeypatch.delenv("HOLOPATH_BACKEND")
    registration._run_command(["devices"])
    assert seen == [used]
