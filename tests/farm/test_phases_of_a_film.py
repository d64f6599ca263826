"""`holopath encode` of an animation: processes share its frames, and other words wait."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from holopath_addon import cli, engine
from holopath_addon.cli import encode_command
from holopath_addon.farm import processes
from holopath_addon.farm.claims import Claims
from holopath_addon.farm.job import SharedJob
from tests.farm.test_sharing import ended, refused, stop, wait_for

ROOT = Path(__file__).parents[2]
GREEN = 516.5e-9


def field_of(seed):
    """Light of random pixels."""
    chance = np.random.default_rng(seed)
    data = chance.normal(size=(1, 1, 24, 24)) + 1j * chance.normal(size=(1, 1, 24, 24))
    hologram = engine.Hologram(24, 24, 8e-6, (GREEN,), -1e-3, 1e-3, near=0.5)
    return engine.WaveField(data.astype(np.complex64), hologram, engine.Camera(np.eye(4), 0.5), 0.5)


def film_of(folder, count):
    for number in range(1, count + 1):
        field_of(number).save(folder / f"frame_{number:04d}" / "wavefield")
    return folder


def words(folder, *more):
    return ["encode", str(folder), "--method", "sgd", "--max-steps", "5", *more]


def start(folder, *more):
    return subprocess.Popen(
        [sys.executable, "-m", "holopath_addon", *words(folder, *more)],
        cwd=ROOT,
        stderr=subprocess.PIPE,
        text=True,
    )


def phases(folder):
    return {path.parts[-3]: path.read_bytes() for path in sorted(folder.glob("*/hologram/phase.npy"))}


def made(output):
    return [int(each.rpartition("Done: ")[2].split()[0]) for each in output]


@pytest.mark.parametrize("more", [(), ("--start", "before")])
def test_two_share_what_a_killed_one_has_left(more, tmp_path):
    alone = film_of(tmp_path / "alone", 12)
    assert cli.main([*words(alone, *more), "--quiet"]) == 0
    film = film_of(tmp_path / "film", 12)
    killed = start(film, *more)
    stop(killed, lambda: len(phases(film)) >= 2 and list(film.glob(".claims/frame_*")))
    killed.send_signal(signal.SIGKILL)
    killed.communicate()
    left = 12 - len(phases(film))
    output = ended(start(film, *more), start(film, *more))
    assert sum(made(output)) == left > 0  # none twice
    assert phases(film) == phases(alone) and len(phases(film)) == 12
    assert sorted(os.listdir(film)) == sorted(os.listdir(alone))


def test_of_two_at_once_one_is_killed(tmp_path):
    """The other makes the rest, with the frame that was begun."""
    alone = film_of(tmp_path / "alone", 12)
    assert cli.main([*words(alone), "--quiet"]) == 0
    film = film_of(tmp_path / "film", 12)
    killed = start(film)
    stop(killed, lambda: phases(film) and list(film.glob(".claims/frame_*")))
    there = len(phases(film))
    other = start(film)
    wait_for(lambda: len(phases(film)) > there, other)
    killed.send_signal(signal.SIGKILL)
    killed.communicate()
    assert made(ended(other)) == [12 - there]
    assert phases(film) == phases(alone) and sorted(os.listdir(film)) == sorted(os.listdir(alone))


def test_other_words_wait(tmp_path, capfd):
    """Frames may be rendered meanwhile, and whoever renders others waits."""
    film = film_of(tmp_path / "film", 2)
    args = cli.parse([str(word) for word in words(film)])
    job = encode_command.work_of(args, print).job
    with job.join(film):
        says = f"is being encoded by {processes.host()} with other options, files or versions. Wait, or give the same"
        refused(cli.main(words(film, "--tolerance", "0.1")), capfd.readouterr().err, says)
        with pytest.raises(
            engine.InvalidInput, match=f"is being encoded by {processes.host()}. Wait, or choose"
        ):
            with SharedJob("scene.blend", {}, {}, {}).join(film):
                pass
        assert not phases(film) and cli.main([*words(film), "--quiet"]) == 0
    with Claims(film, "a render") as renders, renders.claim("frame_0009"):
        assert cli.main(words(film, "--tolerance", "0.1")) == 0
    assert "Done: 2 frames" in capfd.readouterr().err


def test_phases_begin_with_those_of_the_frame_before(tmp_path, monkeypatch, capfd):
    """Phases of a frame that is rendered again, and of all after it, are encoded again."""
    film, begun, encode = film_of(tmp_path / "film", 4), [], engine.encode

    def view(field, method="auto", progress=None, **options):
        begun.append(options["start"])
        return encode(field, method, progress, **options)

    monkeypatch.setattr(engine, "encode", view)
    assert cli.main(words(film, "--start", "before")) == 0
    assert begun[0] == "arg"
    for before, frame in zip(begun[1:], sorted(film.iterdir()), strict=False):
        np.testing.assert_array_equal(before.data, np.load(frame / "hologram" / "phase.npy"))
    assert cli.main(words(film, "--start", "before")) == 0 and len(begun) == 4
    assert "0 frames in" in (output := capfd.readouterr().err) and ", 4 done before or by others" in output
    before = phases(film)
    for path in (film / "frame_0002" / "hologram").iterdir():
        path.unlink()
    (film / "frame_0002" / "hologram").rmdir()
    field_of(9).save(film / "frame_0002" / "wavefield")
    assert cli.main(words(film, "--start", "before")) == 0
    assert len(begun) == 7 and phases(film)["frame_0001"] == before["frame_0001"]
    assert not phases(film).items() & {name: before[name] for name in list(before)[1:]}.items()
    report = json.loads((film / "frame_0004" / "hologram" / "meta.json").read_text())["report"]
    assert report["begun_with"] and report["sha256"] != report["begun_with"]


def test_starts_that_there_are_not(tmp_path, capfd):
    film = film_of(tmp_path / "film", 1)
    refused(
        cli.main(words(film, "--start", "there")),
        capfd.readouterr().err,
        "Expected arg, dpac or before for --start",
    )
    dpac = ["encode", str(film), "--method", "dpac", "--start", "before"]
    refused(cli.main(dpac), capfd.readouterr().err, "gradient descent for --start before, got dpac")
    still = words(film / "frame_0001", "--start", "before")
    refused(cli.main(still), capfd.readouterr().err, "Expected an animation.*or give ./before")
