"""`holopath template`: the job files of farms, which are installed with HoloPath."""

import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from distribution import extension
from holopath_addon import cli
from holopath_addon.cli.template_command import FILES

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize(("farm", "says"), [("flamenco", "const JOB_TYPE"), ("slurm", "#SBATCH --array")])
def test_printed_or_written(farm, says, tmp_path, capfd):
    assert cli.main(["template", farm]) == 0
    text = capfd.readouterr().out
    assert says in text
    target = tmp_path / "new" / "file"
    assert cli.main(["template", farm, "--out", str(target)]) == 0
    assert target.read_text() == text
    target.write_text("mine")
    assert cli.main(["template", farm, "--out", str(target)]) == 2
    assert "exists already. Choose another name" in capfd.readouterr().err
    assert target.read_text() == "mine" and list(target.parent.iterdir()) == [target]


def test_a_farm_that_is_none(capfd):
    assert cli.main(["template", "deadline"]) == 2
    assert "invalid choice: 'deadline'" in capfd.readouterr().err


def test_in_the_extension():
    assert {f"farm/templates/{name}" for name in FILES.values()} <= set(extension.sources())


def test_in_the_wheel(tmp_path):
    copy = tmp_path / "source"
    copy.mkdir()
    for name in ("holopath_addon", "distribution", "pyproject.toml", "LICENSE"):
        (copy / name).symlink_to(ROOT / name)
    build = "from setuptools import build_meta; print(build_meta.build_wheel('../wheel'))"
    subprocess.run([sys.executable, "-c", build], cwd=copy, check=True, capture_output=True)
    (wheel,) = (tmp_path / "wheel").glob("*.whl")
    names = set(zipfile.ZipFile(wheel).namelist())
    assert {f"holopath_addon/farm/templates/{name}" for name in FILES.values()} <= names
