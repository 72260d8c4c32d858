import pytest
from blocks import ROOT


@pytest.fixture(scope="session")
def site(tmp_path_factory):
    """The built site; a warning is an error."""
    pytest.importorskip("mkdocs", reason="the documentation's tools are not installed: pip install --group docs")
    pytest.importorskip("mkdocstrings", reason="the documentation's tools are not installed: pip install --group docs")
    from mkdocs.commands.build import build
    from mkdocs.config import load_config

    folder = tmp_path_factory.mktemp("site")
    build(load_config(str(ROOT / "mkdocs.yml"), site_dir=str(folder), strict=True))
    return folder
