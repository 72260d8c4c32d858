import shutil

import pytest
from driving import Operator, Service

CHROMIUM = ("chromium", "chromium-browser", "google-chrome")
FLAGS = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox"]


@pytest.fixture(scope="session")
def browser():
    """Headless Chromium; skips where there is none."""
    api = pytest.importorskip("playwright.sync_api", reason="needs playwright: pip install playwright")
    path = next((found for name in CHROMIUM if (found := shutil.which(name))), None)
    if path is None:
        pytest.skip(f"needs a Chromium on the PATH ({', '.join(CHROMIUM)}): apt-get install chromium")
    with api.sync_playwright() as playwright:
        started = playwright.chromium.launch(executable_path=path, args=FLAGS)
        yield started
        started.close()


@pytest.fixture(scope="module")
def service(office, tmp_path_factory):
    folder = tmp_path_factory.mktemp("scenes")
    office[1].save(folder / "office.gpdf")
    running = Service({"office": folder / "office.gpdf"}, folder)
    yield running
    running.stop()


@pytest.fixture
def operator(browser, service):
    person = Operator(browser, service.endpoint)
    person.opens("office")
    yield person
    person.close()
