"""Wheel and source distribution, and what each install of the wheel can do in an environment of its own."""

import json
import os
import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent.parent
PACKAGES = ("gpdf_client", "gpdf_guidance", "gpdf_robot", "gpdf_ros2", "gpdf_schemas", "gpdf_service")
HEAVY = ("scipy", "numba", "open3d", "laspy", "mcap", "matplotlib", "viser", "rosbags", "ompl")
WEARABLE = "aarch64-manylinux_2_28"
"""Debian 11 and Ubuntu 20.04 on a 64-bit ARM board, and newer ones."""
pytestmark = pytest.mark.slow


def run(*words, cwd=None, check=True):
    """Run a program without this checkout on its path; what it said stands in the failure."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "GPDF_"))}
    done = subprocess.run([*map(str, words)], cwd=cwd, env=kept, capture_output=True, text=True, timeout=600)
    assert not check or done.returncode == 0, f"{words}\n{done.stdout}\n{done.stderr}"
    return done


def uv(*words, check=True):
    done = run(Path(sys.executable).parent / "uv", *words, check=False)
    if any(
        sign in done.stderr for sign in ("dns error", "Failed to fetch", "error sending request", "Could not connect")
    ):
        pytest.skip(f"the package index is out of reach: {done.stderr.strip().splitlines()[-1]}")
    assert not check or done.returncode == 0, f"{words}\n{done.stderr}"
    return done


@pytest.fixture(scope="module")
def dist(tmp_path_factory):
    """Both distributions, the wheel from the source distribution, as a packager builds them."""
    folder = tmp_path_factory.mktemp("dist")
    run(sys.executable, "-m", "build", "--no-isolation", "--outdir", folder, ROOT)
    (wheel,), (sdist,) = folder.glob("*.whl"), folder.glob("*.tar.gz")
    return wheel, sdist


@pytest.fixture(scope="module")
def install(dist):
    """Installs the wheel with an extra into an environment in a folder, new or not; gives its bin folder."""

    def make(folder, extra="", *flags):
        python = folder / "venv" / "bin" / "python"
        if not python.exists():
            uv("venv", "--python", sys.executable, folder / "venv")
        constraints = ["--constraint", ROOT / "constraints.txt"]
        uv("pip", "install", "--python", python, *flags, *constraints, f"{dist[0]}{extra}")
        return python.parent

    return make


@pytest.fixture(scope="module")
def light(install, tmp_path_factory):
    return install(tmp_path_factory.mktemp("light"), "", "--compile-bytecode")  # its import is timed


def test_wheel_and_source_hold_the_packages_with_their_types_and_licence(dist):
    wheel, sdist = dist
    inside = set(zipfile.ZipFile(wheel).namelist())
    assert {name.partition("/")[0] for name in inside if "dist-info" not in name} == set(PACKAGES)
    assert {f"{package}/py.typed" for package in PACKAGES} <= inside
    assert any(name.endswith("licenses/LICENSE") for name in inside)
    with tarfile.open(sdist) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    assert {
        "pyproject.toml",
        "README.md",
        "LICENSE",
        "clients/gpdf_client/client.py",
        "schemas/CONVENTIONS.md",
    } <= names


def test_wheel_holds_every_module_of_the_checkout(dist):
    inside = {name for name in zipfile.ZipFile(dist[0]).namelist() if name.endswith(".py")}
    roots = [ROOT, ROOT / "clients", ROOT / "schemas"]
    here = {
        file.relative_to(root).as_posix()
        for root in roots
        for package in PACKAGES
        for file in (root / package).rglob("*.py")
    }
    assert inside == here


COLD = """
import sys, time
began = time.perf_counter()
import gpdf_client, gpdf_schemas
seconds = time.perf_counter() - began
resident = next(int(line.split()[1]) / 1024 for line in open("/proc/self/status") if line.startswith("VmRSS"))
heavy = sorted({name.partition(".")[0] for name in sys.modules} & set(sys.argv[1].split()))
import json; print(json.dumps({"seconds": seconds, "resident_mb": resident, "heavy": heavy}))
"""


def test_plain_install_is_the_light_client_alone(light, capsys):
    installed = {
        entry["name"] for entry in json.loads(uv("pip", "list", "--python", light / "python", "--format=json").stdout)
    }
    assert installed == {"gpdf-service", "eclipse-zenoh", "msgpack", "msgspec", "numpy"}
    said = json.loads(run(light / "python", "-c", COLD, " ".join(HEAVY)).stdout)
    assert said["heavy"] == []
    for module in ("gpdf_guidance", "gpdf_robot"):
        run(light / "python", "-c", f"import {module}")
    with capsys.disabled():
        print(f"\nlight client: imported in {said['seconds']:.2f} s, {said['resident_mb']:.0f} MB resident")


def test_plain_install_asks_a_service_and_says_what_the_rest_needs(light, tmp_path, free_endpoint):
    assert run(light / "gpdf", "--version").stdout.strip() == version()
    nobody = run(light / "gpdf", "client", "--endpoint", free_endpoint, "scenes", check=False)
    assert (nobody.returncode, "no service at" in nobody.stderr) == (1, True)
    (tmp_path / "x.ply").touch()
    plan = run(light / "gpdf", "plan", tmp_path / "x.ply", "--start", "1,1", "--goal", "2,2", check=False)
    assert (plan.returncode, "pip install 'gpdf-service[server]'" in plan.stderr) == (1, True)


def version():
    return tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]


MADE = """
import numpy as np
from gpdf_service.synthetic import SCENES
np.savetxt("office.xyz", SCENES["office"](np.random.default_rng(0)).points)
"""


def lend_kernels(scripts):
    """Put what this checkout has compiled beside the same sources of an install: two minutes of processor time."""
    (site,) = scripts.parent.glob("lib/python*/site-packages")
    for source in (ROOT / "gpdf_service").rglob("*.py"):
        stat = source.stat()
        os.utime(site / source.relative_to(ROOT), ns=(stat.st_atime_ns, stat.st_mtime_ns))  # Numba compares it
    for kernel in (ROOT / "gpdf_service").rglob("*.nb[ci]"):
        target = site / kernel.relative_to(ROOT)
        target.parent.mkdir(exist_ok=True)
        shutil.copy(kernel, target)


def test_server_install_plans_and_the_rest_brings_the_page_and_ros(install, tmp_path):
    """From a cloud to a certified plan, with nothing of the checkout but its kernels; `make install` compiles those."""
    scripts = install(tmp_path, "[server]")
    lend_kernels(scripts)
    run(scripts / "python", "-c", MADE, cwd=tmp_path)
    words = ["plan", "office.xyz", "--start", "0.9,0.9", "--goal", "5.4,3.4", "--png", "plan.png"]
    assert run(scripts / "gpdf", *words, cwd=tmp_path).stdout.startswith("OK")
    assert (tmp_path / "plan.png").stat().st_size > 10_000
    for verb in ("serve", "replay", "completion"):
        run(scripts / "gpdf", verb, "--help")
    install(tmp_path, "[all]")
    for verb in ("view", "ros2"):
        run(scripts / "gpdf", verb, "--help")


def resolve_for(platform, requirements, tmp_path):
    file = tmp_path / "requirements.in"
    file.write_text("\n".join(requirements))
    words = ["--python-platform", platform, "--python-version", "3.11", "--only-binary", ":all:"]
    constraints = ["--constraint", ROOT / "constraints.txt"]
    return uv("pip", "compile", file, *words, *constraints, "--no-header", "--no-annotate", check=False)


def test_light_client_has_wheels_for_linux_on_arm(tmp_path):
    light = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["dependencies"]
    done = resolve_for(WEARABLE, light, tmp_path)
    assert done.returncode == 0, done.stderr
    assert len(done.stdout.splitlines()) == len(light)


def test_a_package_without_a_wheel_for_linux_on_arm_would_be_seen(tmp_path):
    """Open3D has none, which is why the server needs x86-64."""
    done = resolve_for(WEARABLE, ["open3d-cpu"], tmp_path)
    assert done.returncode != 0
    assert "open3d-cpu" in done.stderr
