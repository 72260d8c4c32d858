import shutil

import numpy as np
import pytest
from driving import Operator, Service
from house import PAINTED, sample_house

import gpdf_service as gpdf

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


@pytest.fixture(scope="session")
def service(office_file, tmp_path_factory):
    """A service with the office and the house of two storeys."""
    folder = tmp_path_factory.mktemp("scenes")
    shutil.copy(office_file, folder / "office.gpdf")
    points, ground = sample_house()
    colours = np.where(ground[:, None], PAINTED, 255).astype(np.uint8)
    gpdf.build_scene(points, ground, colours=colours).save(folder / "house.gpdf")
    running = Service({name: folder / f"{name}.gpdf" for name in ("office", "house")}, folder)
    yield running
    running.stop()


@pytest.fixture(scope="module")
def _page(browser, service):
    person = Operator(browser, service.endpoint)
    yield person
    person.close()


@pytest.fixture
def operator(_page):
    """A person before the one page of all tests of a module: to open it costs as much as a test."""
    _page.begins()
    return _page
