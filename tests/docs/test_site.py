"""The built site: complete, every link and picture in it leads somewhere, nothing is fetched from elsewhere."""

import json
from html.parser import HTMLParser
from urllib.parse import unquote, urlsplit

import pytest
from blocks import ROOT

from gpdf_service.cli import VERBS

pytestmark = pytest.mark.slow


class Links(HTMLParser):
    """The names that a page has, where it leads to, and what a browser fetches for it."""

    def __init__(self, text):
        super().__init__()
        self.names, self.leads, self.fetched = set(), [], []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        found = dict(attributes)
        self.names |= {found[key] for key in ("id", "name") if found.get(key)}
        if tag == "a" and found.get("href"):
            self.leads.append(found["href"])
        fetched = found.get("src") if tag != "link" else found.get("rel") != "canonical" and found.get("href")
        if fetched:
            self.fetched.append(fetched)


@pytest.fixture(scope="module")
def pages(site):
    return {file: Links(file.read_text()) for file in site.rglob("*.html")}


def test_every_link_and_picture_leads_somewhere(pages, site):
    broken = []
    for page, links in pages.items():
        for link in links.leads + links.fetched:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc or page.name == "404.html":
                continue
            target = (page.parent / unquote(parts.path)).resolve() if parts.path else page
            target = target / "index.html" if target.is_dir() else target
            named = not parts.fragment or target not in pages or unquote(parts.fragment) in pages[target].names
            if not target.is_file() or not named:
                broken.append((page.name, link))
    assert broken == []
    assert sum(len(links.leads) for links in pages.values()) > 500


def test_nothing_is_fetched_from_elsewhere(pages):
    assert [link for links in pages.values() for link in links.fetched if urlsplit(link).netloc] == []


def test_reference_has_every_verb_every_message_and_every_public_name(site):
    import gpdf_service

    cli = (site / "reference" / "cli.html").read_text()
    assert [verb for verb in VERBS if f"usage: gpdf {verb}" not in cli] == []
    messages = (site / "reference" / "messages.html").read_text()
    names = [file.stem for file in (ROOT / "schemas" / "json").glob("*.json")]
    assert [name for name in names if f'id="{name.lower()}"' not in messages] == []
    python = (site / "reference" / "gpdf_service.html").read_text()
    python += (site / "reference" / "configuration.html").read_text()
    public = set(gpdf_service.__all__) - {"AGENTS"}
    assert [name for name in public if f".{name}" not in python] == []


def test_every_measured_row_is_in_a_table(site):
    page = (site / "measured.html").read_text()
    files = list((ROOT / "docs" / "measured").glob("*.json"))
    assert files
    for file in files:
        found = json.loads(file.read_text())
        assert found["command"] in page
    rows = sum(len(json.loads(file.read_text())["rows"]) + 1 for file in files)
    assert page.count("<tr>") == rows


def test_pictures_are_small_and_all_shown():
    shown = "".join(page.read_text() for page in (ROOT / "docs").rglob("*.md")) + (ROOT / "README.md").read_text()
    for picture in (ROOT / "docs" / "pictures").iterdir():
        assert picture.stat().st_size < 100_000
        assert picture.name in shown


def test_a_broken_link_breaks_the_build(tmp_path):
    """Strictness itself: without it the other tests would see a site with holes."""
    pytest.importorskip("mkdocs", reason="the documentation's tools are not installed: pip install --group docs")
    from mkdocs.commands.build import build
    from mkdocs.config import load_config
    from mkdocs.exceptions import Abort

    for target in ("nowhere.md", "index.md#nowhere"):
        docs = tmp_path / "docs"
        docs.mkdir(exist_ok=True)
        (docs / "index.md").write_text(f"# One\n[two]({target})\n")
        settings = {"docs_dir": str(docs), "site_dir": str(tmp_path / "site"), "nav": None, "hooks": [], "plugins": []}
        config = load_config(str(ROOT / "mkdocs.yml"), strict=True, **settings)
        with pytest.raises(Abort):
            build(config)
