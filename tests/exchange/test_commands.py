"""`holopath export` and `holopath import`, as they are typed."""

import gc
import json
import signal

import numpy as np
import pytest

from holopath_addon import cli, engine, exchange
from holopath_addon.engine.viewing import assessment
from holopath_addon.exchange import containers
from holopath_addon.workflow import output
from tests.exchange import fields, foreign


@pytest.fixture
def rendered(tmp_path):
    """An output folder with a field and phases."""
    folder = tmp_path / "rendered"
    fields.field().save(folder / "wavefield")
    fields.phases().save(folder / "hologram")
    return folder


@pytest.mark.parametrize("suffix", [s for s in exchange.SUFFIXES if s not in (".npy", ".hdf5")])
def test_there_and_back(suffix, rendered, tmp_path):
    file, out = tmp_path / f"a{suffix}", tmp_path / "out"
    assert cli.main(["export", str(rendered), str(file), "--quiet"]) == 0
    assert cli.main(["import", str(file), "--out", str(out), "--quiet"]) == 0
    ours = engine.WaveField.load(out / "wavefield")
    assert np.array_equal(ours.data, fields.field().data) and ours.plan == fields.field().plan
    assert json.loads((out / "report.json").read_text())["imported"] == str(file)


def test_phases_refocus_and_focus_by_distance(rendered, tmp_path, capsys):
    file, out = tmp_path / "a.npz", tmp_path / "out"
    assert cli.main(["export", str(rendered), str(file), "--hologram", "--quiet"]) == 0
    assert cli.main(["import", str(file), "--out", str(out)]) == 0
    assert "refocus them with --hologram" in capsys.readouterr().err
    words = ["reconstruct", str(out), "--hologram", "--quiet", "--distances"]
    assert cli.main([*words, "1,3"]) == 0
    names = sorted(path.name for path in (out / "reconstruction").glob("*.png"))
    assert names == ["hologram_distance_1mm.png", "hologram_distance_3mm.png"]
    assert cli.main([*words, "0.5"]) == 2
    assert "0.5 mm from the SLM is beyond infinity, which is at 1 mm in this field" in capsys.readouterr().err


def test_an_array_of_its_own_convention(tmp_path):
    array = np.random.default_rng(0).normal(size=(5, 7, 2)) + 0j
    np.save(tmp_path / "u.npy", array)
    out = tmp_path / "out"
    words = ["import", str(tmp_path / "u.npy"), "--out", str(out), "--quiet", "--pitch", "4"]
    words += ["--wavelengths", "640,455.4", "--axes", "x,y,wavelength", "--time", "+", "--row-0", "bottom"]
    assert cli.main([*words, "--near", "2", "--fov", "20", "--depth-range", "1,2"]) == 0
    ours = engine.WaveField.load(out / "wavefield")
    assert np.array_equal(ours.data[0], np.conj(array).transpose(2, 1, 0)[:, ::-1].astype(np.complex64))
    assert ours.near == 2 and ours.hologram.depth_near == 2e-3
    assert ours.camera.fov_x == pytest.approx(np.radians(20))


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["import", "none.h5", "--out", "new"], "does not exist. Give a file of"),
        (["import", "u.npy", "--out", "new"], "The file has no pixel pitch. Give --pitch, in micrometers"),
        (["import", "u.npy", "--out", "full"], "The output full exists already. Choose a new folder"),
        (
            ["import", "u.npy", "--out", "new", "--axes", "y,y"],
            "Expected axes frame,wavelength,y,x in any order",
        ),
        (["export", "none", "a.h5"], "The folder none does not exist"),
        (["export", "rendered", "a.tga"], "Expected a file of"),
        (["export", "rendered", "a.tif"], "Fields and phases cannot be written as pictures. Give a file"),
        (
            ["import", "a.npy", "b.npy", "--out", "new"],
            "Expected a role for each file of a field. Write amplitude=FILE phase=FILE",
        ),
        (
            ["import", "phase=u.npy", "--out", "new", "--pitch", "8"],
            "which cannot be a phase. Give",
        ),
        (
            ["import", "phase=u.npy", "real=u.npy", "--out", "new", "--array", "u"],
            "Write for example --array phase=u",
        ),
        (["import", "u.npy", "--out", "new", "--array", "phase=a,phase=b"], "Expected each role once"),
        (
            ["export", "rendered", "a.h5", "--convention", "odak"],
            "There are 3 frames, but no axis for them. Name it",
        ),
    ],
)
def test_what_is_refused_leaves_nothing(words, says, rendered, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    np.save("u.npy", np.ones((4, 4), complex))
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "thesis.tex").touch()
    before = sorted(tmp_path.rglob("*"))
    assert cli.main(words) == 2
    assert says in capsys.readouterr().err
    assert sorted(tmp_path.rglob("*")) == before


def test_a_page_for_what_was_taken_in(rendered, tmp_path, capsys):
    """Pages of fields, of phases, and of both load nothing from elsewhere."""
    assert cli.main(["report", str(rendered), "--quiet"]) == 0
    page, table = (rendered / f"report.{kind}" for kind in ("html", "csv"))
    text = page.read_text()
    assert "http" not in text and text.isascii() and "<h2>Phases (joint)</h2>" in text
    curves, sketch = text.split("<h2>Bench</h2>")
    assert curves.count("<img") == 4 and curves.count("<polyline") == 9 and "<svg" in sketch
    rows = [line.rsplit(",", 1) for line in table.read_text().splitlines()]
    assert rows[0] == ["what,where", "value"] and len(rows) > 9 * 13 + 13 + 2 + 1
    (rendered / "wavefield").rename(tmp_path / "aside")
    assert cli.main(["report", str(rendered), "--out", str(tmp_path / "phases.html"), "--quiet"]) == 0
    assert "relative to those of the complex field" not in (tmp_path / "phases.html").read_text()
    assert cli.main(["report", str(tmp_path / "aside"), "--out", str(tmp_path / "a.txt")]) == 2
    assert "Expected a page with the suffix .html" in capsys.readouterr().err
    assert cli.main(["report", str(tmp_path / "none")]) == 2
    assert "does not exist" in capsys.readouterr().err


def ctrl_c(*_args, **_options):
    signal.raise_signal(signal.SIGINT)


@pytest.mark.parametrize("suffix", [".h5", ".mat", ".npz", ".npy", ".safetensors"])
def test_an_export_that_is_interrupted_leaves_what_was_there(suffix, rendered, tmp_path, capsys, monkeypatch):
    folder, words = (
        tmp_path / "files",
        ["export", str(rendered), str(tmp_path / "files" / f"a{suffix}"), "--quiet"],
    )
    reader, writer = containers._KINDS[suffix]

    def half(path, container):
        writer(path, container)
        path.write_bytes(path.read_bytes()[:300])
        ctrl_c()

    monkeypatch.setitem(containers._KINDS, suffix, (reader, half))
    interrupted(words, folder, [], capsys)
    (folder / f"a{suffix}").write_text("before")
    interrupted(words, folder, [f"a{suffix}"], capsys)
    assert (folder / f"a{suffix}").read_text() == "before"


@pytest.mark.parametrize(("where", "what"), [(assessment, "brightness"), (output, "rename")])
def test_a_report_that_is_interrupted_leaves_nothing(where, what, rendered, tmp_path, capsys, monkeypatch):
    """While it computes, and when the page and its table are to be put in their places."""
    folder = tmp_path / "pages"
    folder.mkdir()
    monkeypatch.setattr(where, what, ctrl_c)
    interrupted(["report", str(rendered), "--out", str(folder / "a.html"), "--quiet"], folder, [], capsys)


def interrupted(words, folder, left, capsys):
    assert cli.main(words) == 1
    assert capsys.readouterr().err == "holopath: Canceled: nothing was written.\n"
    assert [path.name for path in folder.iterdir()] == left


@pytest.mark.filterwarnings("error")
def test_an_archive_that_is_interrupted_says_no_more(rendered, tmp_path, capsys, monkeypatch):
    folder = tmp_path / "files"
    monkeypatch.setattr(np.lib.format, "write_array", ctrl_c)
    interrupted(["export", str(rendered), str(folder / "a.npz"), "--quiet"], folder, [], capsys)
    gc.collect()


def test_a_field_of_two_pictures(tmp_path, monkeypatch):
    """Amplitude as a screen's picture, phases as levels of 10 bits at the top of 16."""
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(5)
    amplitude, levels = rng.integers(0, 256, (8, 9), np.uint8), rng.integers(0, 1024, (8, 9))
    foreign.png(tmp_path / "a.png", amplitude, 8)
    foreign.png(tmp_path / "p.png", (levels << 6).astype(np.uint16), 16)
    words = ["import", "amplitude=a.png", "phase=p.png", "--transfer", "linear", "--bits", "10"]
    assert cli.main([*words, "--pitch", "8", "--wavelengths", "516.5", "--out", "out", "--quiet"]) == 0
    ours = engine.WaveField.load(tmp_path / "out" / "wavefield")
    truth = amplitude / 255 * np.exp(2j * np.pi * levels / 1024)
    np.testing.assert_allclose(ours.data[0, 0], truth, atol=1e-6)
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["imported"] == ["amplitude=a.png", "phase=p.png"]


def test_arrays_of_one_file_by_their_roles(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    a, p = np.full((6, 7), 0.5), np.linspace(0, 0.9, 42).reshape(6, 7)
    np.savez("a.npz", A=a, P=p, Q=p)
    words = ["import", "a.npz", "--array", "amplitude=A,phase=P", "--units", "turns", "--pitch", "8"]
    assert cli.main([*words, "--wavelengths", "516.5", "--out", "out", "--quiet"]) == 0
    ours = engine.WaveField.load(tmp_path / "out" / "wavefield")
    np.testing.assert_allclose(ours.data[0, 0], a * np.exp(2j * np.pi * p), atol=1e-6)
