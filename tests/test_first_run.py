"""What somebody reads whose installation is not complete: the one command that mends it."""

import contextlib
import os
import pty
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from gpdf_service.cli import main
from gpdf_service.clouds.formats import SYSTEM_LIBRARIES

WITHOUT = """
import sys
class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] == sys.argv[1]:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
sys.meta_path.insert(0, Absent())
from gpdf_service.cli import main
sys.exit(main(sys.argv[2:]))
"""


@pytest.mark.parametrize(
    ("module", "words", "command"),
    [
        ("numba", ["plan", "x.npz", "--start", "1,1", "--goal", "2,2"], "pip install 'gpdf-service[server]'"),
        ("mcap", ["serve"], "pip install 'gpdf-service[server]'"),
        ("viser", ["view"], "pip install 'gpdf-service[viewer]'"),
        ("rosbags", ["ros2", "office"], "pip install 'gpdf-service[ros2]'"),
        ("laspy", ["scene", "info", "room.las"], "pip install 'gpdf-service[server]'"),
        ("shtab", ["completion", "bash"], "pip install 'gpdf-service[server]'"),
    ],
)
def test_a_missing_extra_is_named_with_the_command_that_brings_it(module, words, command, tmp_path):
    (tmp_path / "room.las").write_text("LASF")
    (tmp_path / "x.npz").touch()
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT, module, *words], capture_output=True, text=True, cwd=tmp_path, timeout=60
    )
    assert done.returncode == 1
    assert done.stderr.strip().splitlines() == [f"gpdf {verb_of(words)} needs {module}: {command}"]


def verb_of(words):
    return " ".join(words[:2]) if words[0] == "scene" else words[0]


@pytest.mark.parametrize(("library", "package"), SYSTEM_LIBRARIES.items())
@pytest.mark.parametrize("kind", ["OSError", "ImportError"])
def test_a_missing_system_library_is_named_with_its_package(library, package, kind, tmp_path, monkeypatch, capsys):
    """Open3D fails as the dynamic linker makes it fail."""
    (tmp_path / "open3d").mkdir()
    words = f"{library}: cannot open shared object file: No such file or directory"
    (tmp_path / "open3d" / "__init__.py").write_text(f"raise {kind}({words!r})")
    (tmp_path / "room.ply").write_text("ply")
    for name in [name for name in sys.modules if name.partition(".")[0] == "open3d"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.syspath_prepend(tmp_path)
    assert main(["scene", "info", str(tmp_path / "room.ply")]) == 1
    said = capsys.readouterr().err
    assert library in said
    assert f"Install {package}: sudo apt-get install " in said


def test_makefile_dockerfile_and_message_name_the_same_packages():
    root = Path(__file__).parent.parent
    for name in ("Makefile", "docker/Dockerfile"):
        text = (root / name).read_text()
        assert [package for package in SYSTEM_LIBRARIES.values() if package not in text] == []


def test_a_terminal_is_told_once_why_the_first_run_takes_longer(tmp_path):
    np.savez(tmp_path / "wide.npz", xyz=np.array([[0.0, 0.0, 0.0], [6000.0, 0.0, 0.0]]))  # refused by the first kernel
    words = [sys.executable, "-m", "gpdf_service.cli", "scene", "info", "wide.npz"]
    fresh = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    said = []
    for environment in (fresh, fresh):
        ours, theirs = pty.openpty()
        subprocess.run(words, stderr=theirs, stdout=subprocess.DEVNULL, cwd=tmp_path, env=environment)
        os.close(theirs)
        said.append(_all_of(ours).count("compiling for this machine, once"))
    assert said == [1, 0]


def _all_of(terminal):
    text = b""
    with contextlib.suppress(OSError):  # nobody holds its other end: it is read to the end
        while part := os.read(terminal, 4096):
            text += part
    os.close(terminal)
    return text.decode()
