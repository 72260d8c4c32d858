"""The dependency rule of ARCHITECTURE.md, read from the imports themselves."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
BASE = {"types", "errors", "config", "cores", "kernel_cache"}
ALLOWED = {
    "errors": set(),
    "types": {"errors"},
    "config": {"errors"},
    "cores": set(),
    "kernel_cache": set(),
    "packing": set(),
    "store": {"errors", "packing"},
    "fields": BASE,
    "denoise": BASE | {"fields"},
    "tiles": BASE | {"fields"},
    "clouds": BASE | {"tiles"},
    "ground": BASE | {"fields", "tiles"},
    "perception": BASE | {"clouds", "denoise", "fields", "ground", "store", "tiles"},
    "synthetic": BASE,
    "search": BASE | {"fields", "ground", "store", "tiles"},
    "planning": BASE | {"fields", "ground", "search", "tiles"},
    "shades": BASE | {"fields"},
    "scene": BASE | {"clouds", "denoise", "fields", "ground", "perception", "search", "shades", "store", "tiles"},
    "baselines": BASE | {"fields", "ground", "search", "planning", "scene", "tiles"},
    "pipeline": BASE | {"baselines", "clouds", "fields", "perception", "planning", "scene", "shades", "tiles"},
}
CLIENTS = {"gpdf_client", "gpdf_guidance", "gpdf_robot", "gpdf_ros2"}
WIRE = {"zenoh", "msgpack", "msgspec", "mcap", "gpdf_schemas"} | CLIENTS
LIGHT = {"zenoh", "msgpack", "msgspec", "numpy", "gpdf_schemas"} | CLIENTS
OPTIONAL = {"gpdf_ros2": {"rosbags"}, "phone": {"websockets", "cryptography", "segno"}, "belt": {"pybelt"}}
"""What a client, or one module of it, needs beyond the light install: an extra of its own."""


def imports_of(path):
    """Every module that a file imports, at any depth of it."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            if node.module == "gpdf_service":
                yield from (f"gpdf_service.{alias.name}" for alias in node.names)
            else:
                yield node.module
        elif isinstance(node, ast.ImportFrom):
            pytest.fail(f"{path} has a relative import")


def files_of(layer):
    folder = ROOT / "gpdf_service" / layer
    return sorted(folder.rglob("*.py")) if folder.is_dir() else [folder.with_suffix(".py")]


@pytest.mark.parametrize("layer", ALLOWED)
def test_a_layer_imports_only_the_layers_below_it(layer):
    files = files_of(layer)
    assert files
    for path in files:
        for name in imports_of(path):
            top, _, rest = name.partition(".")
            if top == "gpdf_service":
                target = rest.partition(".")[0]
                assert target in ALLOWED[layer] | {layer}, f"{path.relative_to(ROOT)} imports {name}"
            assert top not in WIRE, f"{path.relative_to(ROOT)} imports {name}"


@pytest.mark.parametrize("name", ["judge", "brute"])
def test_those_who_judge_share_no_code_with_the_planner(name):
    own = {module for module in imports_of(ROOT / "gpdf_service" / "bench" / f"{name}.py") if "gpdf_service" in module}
    assert own == {"gpdf_service.types"}


def test_the_operators_page_is_a_client_and_imports_no_planning():
    data, logs, files = "gpdf_service.types", "gpdf_service.service.replay", "gpdf_service.clouds"
    allowed = {data, logs, files, "gpdf_service.errors", "gpdf_service.ports"}
    pages = [path for path in files_of("viewer") if path.name != "picture.py"]  # pictures are drawn from scenes
    assert len(pages) > 5
    for path in pages:
        for name in imports_of(path):
            inside = name.startswith("gpdf_service.") and not name.startswith("gpdf_service.viewer")
            assert not inside or name in allowed, f"{path.relative_to(ROOT)} imports {name}"


def test_the_operators_page_starts_without_the_servers_libraries():
    heavy = ["numba", "scipy", "matplotlib", "open3d", "mcap"]
    code = f"import sys, gpdf_service.viewer.page; assert not set({heavy}) & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize("folder", ["clients", "schemas"])
def test_clients_and_schemas_import_only_what_the_light_install_has(folder):
    files = sorted((ROOT / folder).rglob("*.py"))
    assert files
    for path in files:
        for name in imports_of(path):
            top = name.partition(".")[0]
            known = LIGHT | OPTIONAL.get(path.parent.name, set()) | OPTIONAL.get(path.stem, set())
            assert top in known or top in sys.stdlib_module_names, f"{path.relative_to(ROOT)} imports {name}"
            assert folder != "schemas" or top not in CLIENTS | {"zenoh"}, f"{path} imports {name}"
