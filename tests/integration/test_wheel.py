"""What people install: a wheel built from the sdist, outside the checkout, flies too."""

import json
import subprocess
import sys
import sysconfig
import venv
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FLIGHT = (
    "run", "--connect", "mock:px4", "--map", "env1", "--target", "22,10,8",
    "--arm", "--takeoff", "6", "--engage", "--json",
)  # fmt: skip


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """Build the sdist, and the wheel from the sdist, as an index would serve them."""
    out = tmp_path_factory.mktemp("dist")
    build = [sys.executable, "-m", "build", "--no-isolation", "--outdir", str(out), str(ROOT)]
    subprocess.run(build, check=True, capture_output=True)
    (path,) = out.glob("*.whl")
    return path


@pytest.fixture
def empty_venv(tmp_path):
    venv.create(tmp_path / "venv", with_pip=True)
    return tmp_path / "venv"


def fly(folder, cwd):
    done = subprocess.run(
        [folder / "bin" / "companion", *FLIGHT],
        cwd=cwd,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["outcome"] == "arrived"
    assert (cwd / "sessions").is_dir()


def test_the_wheel_holds_the_packages_the_maps_and_the_actors(wheel):
    names = zipfile.ZipFile(wheel).namelist()
    tops = {name.split("/")[0] for name in names if ".dist-info" not in name}
    assert tops == {"companion", "sim", "training"}
    for wanted in ("companion/_maps/env1.yaml", "companion/actors/paper-free.onnx"):
        assert wanted in names
    assert not [name for name in names if name.startswith("tests")]


def test_flies_from_an_empty_environment(wheel, empty_venv, tmp_path):
    """Ours from the wheel alone; other people's packages as they are installed here."""
    pip = [empty_venv / "bin" / "python", "-m", "pip", "install", "--quiet", "--no-deps"]
    subprocess.run([*pip, str(wheel)], check=True, capture_output=True)
    (site,) = (empty_venv / "lib").glob("python*/site-packages")
    # A path in a .pth file is no site folder: an editable install there is not followed.
    (site / "others.pth").write_text(sysconfig.get_paths()["purelib"] + "\n")
    where = subprocess.run(
        [empty_venv / "bin" / "python", "-c", "import companion; print(companion.__file__)"],
        cwd=tmp_path, check=True, capture_output=True, text=True,
    ).stdout  # fmt: skip
    assert str(empty_venv) in where
    fly(empty_venv, tmp_path)


@pytest.mark.slow
def test_flies_after_a_real_installation(wheel, empty_venv, tmp_path):
    """The declared dependencies are enough."""
    pip = [empty_venv / "bin" / "python", "-m", "pip", "install", "--quiet"]
    subprocess.run([*pip, "--upgrade", "pip"], check=True, capture_output=True)
    subprocess.run([*pip, str(wheel)], check=True, capture_output=True)
    missing = subprocess.run(
        [empty_venv / "bin" / "python", "-c", "import torch"], capture_output=True, check=False
    )
    assert missing.returncode != 0, "the vehicle does not need torch"
    told = subprocess.run(
        [empty_venv / "bin" / "training", "train"], capture_output=True, text=True, check=False
    )
    assert told.returncode == 2
    assert "mavlink-companion[training]" in told.stderr
    assert "Traceback" not in told.stderr
    fly(empty_venv, tmp_path)
