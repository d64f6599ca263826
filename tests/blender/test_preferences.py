"""Preferences of the add-on."""

from holopath_addon.blender import preferences


def test_where_baked_light_is_kept(monkeypatch, tmp_path):
    from types import SimpleNamespace

    monkeypatch.setattr(preferences, "_chosen", lambda: SimpleNamespace(bake_folder=str(tmp_path / "named")))
    assert preferences.store().folder == tmp_path / "named"
    monkeypatch.setattr(preferences, "_chosen", lambda: None)
    monkeypatch.setenv("HOLOPATH_CACHE", str(tmp_path))
    assert preferences.store().folder == tmp_path
