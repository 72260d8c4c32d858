"""The dependency rule of ARCHITECTURE.md, read from the imports themselves."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
BASE = {"types", "errors", "config"}
ALLOWED = {
    "errors": set(),
    "types": {"errors"},
    "config": {"errors"},
    "store": {"errors"},
    "fields": BASE,
    "perception": BASE,
    "synthetic": BASE,
    "search": BASE | {"fields", "perception"},
    "planning": BASE | {"fields", "perception", "search"},
    "scene": BASE | {"fields", "perception", "search", "store"},
    "pipeline": BASE | {"fields", "perception", "planning", "scene"},
}
WIRE = {"zenoh", "msgpack", "msgspec", "mcap", "gpdf_schemas", "gpdf_client", "gpdf_guidance"}
LIGHT = {"zenoh", "msgpack", "msgspec", "numpy", "gpdf_schemas", "gpdf_client", "gpdf_guidance"}


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


@pytest.mark.parametrize("folder", ["clients", "schemas"])
def test_clients_and_schemas_import_only_what_the_light_install_has(folder):
    import sys

    files = sorted((ROOT / folder).rglob("*.py"))
    assert files
    for path in files:
        for name in imports_of(path):
            top = name.partition(".")[0]
            assert top in LIGHT or top in sys.stdlib_module_names, f"{path.relative_to(ROOT)} imports {name}"
            assert folder != "schemas" or top not in {"gpdf_client", "gpdf_guidance", "zenoh"}, f"{path} imports {name}"
