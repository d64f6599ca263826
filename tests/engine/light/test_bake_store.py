"""Files of baked light: broken ones are baked again, writers do not disturb each other, the oldest go."""

import os
import threading
from dataclasses import replace

import numpy as np
import pytest

from holopath_addon import engine
from holopath_addon.engine.light import bake_store
from holopath_addon.engine.light.bake_store import SUFFIX, Stored


@pytest.fixture(scope="module")
def triangles(build):
    from holopath_addon.engine.light.atlas import Triangles

    scene = build.scene(a=build.plane(1.0, build.diffuse(build.gray(0.5))))
    return Triangles(scene, lambda shape: True)


@pytest.fixture(scope="module")
def stored(triangles):
    """Two groups, on a rectangle with a front and a back."""
    from holopath_addon.engine.light.atlas import Atlas, lay_out
    from holopath_addon.engine.light.groups import Groups
    from holopath_addon.engine.light.radiance_cache import RadianceCache

    number = triangles.owners[0].number
    layout = lay_out(triangles, np.full(triangles.parts, 0.05), {(number, 0), (number, 1)}, lambda done: None)
    cache = RadianceCache(Atlas(triangles, layout), True, False)
    texels = cache.coarse.pool[:2]
    cache.add(Groups.of(cache.atlas, texels, 1), np.array([[0.1, 0.2, 0.3, 1], [0.4, 0.5, 0.6, 1]]))
    return Stored.of(cache, "digest", 0.05, 64)


@pytest.fixture
def store(tmp_path, triangles, stored):
    """With one file."""
    store = engine.BakeStore(tmp_path / "baked")
    store.save(triangles, stored)
    return store


def same(one, other):
    return all(np.array_equal(value, getattr(other, name)) for name, value in vars(one).items())


def test_what_is_saved_is_loaded(store, triangles, stored):
    found, note = store.load(triangles)
    assert same(found, stored) and note == ""
    cache = found.cache(triangles, True, False)
    assert cache.baked(stored.pool).all() and np.array(cache.fine)[4:7] == pytest.approx([0.1, 0.2, 0.3])
    assert store.size() == store.size(triangles) > 0
    assert store.clear() > 0
    assert store.load(triangles) == (None, "") and store.size() == 0


def test_a_job_begins_with_what_is_there_and_gives_what_it_bakes(store, triangles, stored, tmp_path):
    (tmp_path / "job").mkdir()
    job = bake_store.JobStore(tmp_path / "job", store)
    assert not job.empty and job.files() == []
    assert job.head(triangles) == store.head(triangles) and job.speed == store.folder
    assert same(job.load(triangles)[0], stored) and len(job.files()) == 1
    more = replace(stored, digest="more")
    job.save(triangles, more)
    assert same(store.load(triangles)[0], more) and same(job.load(triangles)[0], more)


def test_a_job_clears_its_own_light_alone(store, triangles, stored, tmp_path):
    """Where it begins with nothing, too: the user's store may hold light of other scenes."""
    store.save(triangles, stored)
    job = bake_store.JobStore(tmp_path / "job", store)
    assert not job.empty and job.clear() == 0
    assert store.load(triangles)[0] is not None


def test_a_sealed_one_is_read_alone(store, triangles, stored, tmp_path):
    (tmp_path / "job").mkdir()
    sealed = bake_store.JobStore(tmp_path / "job", store, sealed=True)
    sealed.save(triangles, stored)
    assert sealed.load(triangles) == (None, "") and sealed.head(triangles) is None and sealed.files() == []
    assert not list((tmp_path / "job").iterdir()) and same(store.load(triangles)[0], stored)


def test_a_job_has_its_light_where_the_users_own_store_cannot_be_written(triangles, stored, tmp_path):
    (tmp_path / "file").write_text("")
    (tmp_path / "job").mkdir()
    job = bake_store.JobStore(tmp_path / "job", engine.BakeStore(tmp_path / "file"))
    job.save(triangles, stored)
    assert same(job.load(triangles)[0], stored)


def test_a_bake_of_nothing_is_loaded(store, triangles, stored):
    """Of a view in which all that scatters light is traced."""
    from holopath_addon.engine.light.radiance_cache import RadianceCache

    cache = RadianceCache(stored.cache(triangles, True, False).atlas, False, False)
    store.save(triangles, Stored.of(cache, "digest", 0.05, 64))
    found, note = store.load(triangles)
    assert note == "" and found.cache(triangles, False, False).groups == []


def test_nothing_is_pickled(store, triangles):
    """Neither written nor read: a pickle in a file could do anything."""
    with np.load(store._file(triangles), allow_pickle=False) as arrays:
        values = {name: arrays[name] for name in arrays.files}
    values["texel"] = np.array([{"a": 1}], object)
    np.savez(store._file(triangles), **values)
    found, note = store.load(triangles)
    assert found is None and "baked again" in note


def damaged(data, kind):
    if kind == "truncated":
        return data[: len(data) // 2]
    if kind == "flipped":
        return data[: len(data) // 2] + bytes([data[len(data) // 2] ^ 0xFF]) + data[len(data) // 2 + 1 :]
    return {"empty": b"", "text": b"no archive", "zeros": bytes(len(data))}[kind]


@pytest.mark.parametrize("kind", ["truncated", "flipped", "empty", "text", "zeros"])
def test_a_damaged_file_is_baked_again(store, triangles, kind):
    file = store._file(triangles)
    file.write_bytes(damaged(file.read_bytes(), kind))
    found, note = store.load(triangles)
    assert found is None and file.name in note and note.endswith("It is baked again.")


def test_no_flipped_bit_escapes(store, triangles, stored):
    """Wherever it is, the file is refused, or tells the same."""
    file = store._file(triangles)
    whole = file.read_bytes()
    for place in np.random.default_rng(0).choice(len(whole), min(600, len(whole)), replace=False):
        data = bytearray(whole)
        data[place] ^= 1 << place % 8
        file.write_bytes(data)
        found, note = store.load(triangles)
        assert bool(note) if found is None else same(found, stored)


def changed(array, value, index=0):
    array = np.array(array)
    array.flat[index] = value
    return array


@pytest.mark.parametrize(
    "wrong",
    [
        lambda s: {"corners": s.corners[:-1]},
        lambda s: {"texel": s.texel[:0]},
        lambda s: {"corners": changed(s.corners, np.nan)},
        lambda s: {"corners": changed(s.corners, 1e9)},
        lambda s: {"texel": changed(s.texel, 0)},
        lambda s: {"copies": s.copies[:, :4]},
        lambda s: {"copies": changed(s.copies, 7)},
        lambda s: {"copies": changed(s.copies, 1 << 40, 2)},
        lambda s: {"size": (s.size[0], 1)},
        lambda s: {"size": (1 << 20, 1 << 20)},
        lambda s: {"fine": s.fine[:-1]},
        lambda s: {"fine": changed(s.fine, np.nan, 5)},
        lambda s: {"source": changed(s.source, np.inf)},
        lambda s: {"counts": changed(s.counts, 2)},
        lambda s: {"starts": changed(s.starts, 9)},
        lambda s: {"pool": changed(s.pool, 1 << 30)},
        lambda s: {"pool": s.pool.astype(float)},
        lambda s: {"laid": s.laid.astype(float)},
    ],
)
def test_what_does_not_fit_is_baked_again(store, triangles, stored, wrong):
    store.save(triangles, replace(stored, **wrong(stored)))
    found, note = store.load(triangles)
    assert found is None and "do not fit" in note


def test_other_groups_are_baked_again(store, triangles, stored):
    store.save(triangles, replace(stored, source=stored.source[:-4]))
    assert store.load(triangles)[0].cache(triangles, True, False) is None


def test_another_version_is_baked_again(store, triangles, stored, monkeypatch):
    monkeypatch.setattr(bake_store, "VERSION", bake_store.VERSION + 1)
    assert store.load(triangles) == (None, "")
    store.save(triangles, stored)
    assert same(store.load(triangles)[0], stored)


def test_half_written_files_are_ignored(store, triangles, stored, monkeypatch):
    """A writer that dies, or is stopped, leaves what was there before."""
    (store.folder / ".part-abc").write_bytes(b"half")
    assert store.files() == [store._file(triangles)]

    def stops(stream, **values):
        stream.write(b"half")
        raise KeyboardInterrupt

    monkeypatch.setattr(np, "savez", stops)
    with pytest.raises(KeyboardInterrupt):
        store.save(triangles, replace(stored, digest="new"))
    assert sorted(os.listdir(store.folder)) == [".part-abc", store._file(triangles).name]
    assert same(store.load(triangles)[0], stored)


def test_a_folder_that_cannot_be_written_to(tmp_path, triangles, stored):
    (tmp_path / "file").write_text("in the way")
    store = engine.BakeStore(tmp_path / "file")
    assert store.load(triangles)[0] is None and store.size() == 0 and store.clear() == 0
    with pytest.raises(engine.InvalidInput, match=f"cannot be stored in {tmp_path}/file .*HOLOPATH_CACHE"):
        store.save(triangles, stored)


def test_writers_at_once_leave_one_whole_file(store, triangles, stored):
    def write(digest):
        for _ in range(20):
            store.save(triangles, replace(stored, digest=digest))

    writers = [threading.Thread(target=write, args=(digest,)) for digest in "ab"]
    for writer in writers:
        writer.start()
    while any(writer.is_alive() for writer in writers):
        found, note = store.load(triangles)
        assert found is not None, note
    for writer in writers:
        writer.join()
    assert store.load(triangles)[0].digest in "ab" and len(os.listdir(store.folder)) == 1


def test_the_oldest_files_go(store, triangles, stored, monkeypatch):
    size = store.size()
    names = [f"{k:032d}{SUFFIX}" for k in range(3)]
    for age, name in enumerate(names):
        (store.folder / name).write_bytes(bytes(size))
        os.utime(store.folder / name, (age, age))
    monkeypatch.setattr(bake_store, "MAX_BYTES", 2 * size + 10)
    store.save(triangles, stored)
    assert {file.name for file in store.files()} == {names[2], store._file(triangles).name}
    assert store.clear() == 2 * size and store.files() == []


def test_the_users_own_folder(monkeypatch, tmp_path):
    monkeypatch.setenv("HOLOPATH_CACHE", str(tmp_path))
    assert engine.BakeStore.default().folder == tmp_path
    monkeypatch.delenv("HOLOPATH_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setenv("LOCALAPPDATA", str(tmp_path))
    assert engine.BakeStore.default().folder.name == "holopath"
