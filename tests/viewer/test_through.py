"""Ways under a floor, as a browser draws them: seen faded through it, and as ever where nothing covers them."""

import io
from pathlib import Path

import numpy as np
import pytest
import viser
from driving import free_port, until
from gpdf_client import Trajectory
from PIL import Image

from gpdf_service.viewer.frame import Frame
from gpdf_service.viewer.front import front_page
from gpdf_service.viewer.gate import Gate
from gpdf_service.viewer.path_layers import PathLayers

pytestmark = [pytest.mark.slow, pytest.mark.browser]
WAY, FLOOR = np.array([213, 94, 0]), (40, 90, 200)
SIZE = 600
FAR = 10.0
"""[m] From the way straight up to the eye."""


WAY_ALONG = Trajectory(
    *(np.array([[-2.0, 0.0, z], [2.0, 0.0, z]]) for z in (1.0, 0.0)), np.array([0.0, 4.0]), np.zeros(2)
)


@pytest.fixture
def seen(browser):
    """A way on the ground, with a floor over its right half: what the browser shows of it from straight above."""
    server = viser.ViserServer("127.0.0.1", free_port(), verbose=False)
    server.initial_camera.position, server.initial_camera.look_at = (0.0, -0.01, FAR), (0.0, 0.0, 0.0)
    corners = np.array([[0.0, -2.0, 1.0], [4.0, -2.0, 1.0], [4.0, 2.0, 1.0], [0.0, 2.0, 1.0]])
    server.scene.add_mesh_simple("/floor", corners, np.array([[0, 1, 2], [0, 2, 3]]), color=FLOOR, side="double")
    PathLayers(server.scene, Frame()).add_line("plan", WAY_ALONG, WAY.astype(np.uint8))

    def shown(front):
        port = free_port()
        gate = Gate("127.0.0.1", port, ("127.0.0.1", server.get_port()), "t", front=front)
        with browser.new_context(viewport={"width": SIZE, "height": SIZE}) as context:
            web = context.new_page()
            web.goto(f"http://127.0.0.1:{port}/?token=t")
            picture = np.zeros((SIZE, SIZE, 3), int)
            until(lambda: of_the_way(look(web, picture)[:, : SIZE // 2]).any())
        gate.close()
        return picture

    yield shown
    server.stop()


def plain_page():
    return (Path(viser.__file__).parent / "client" / "build" / "index.html").read_bytes()


def look(web, picture):
    picture[:] = np.asarray(Image.open(io.BytesIO(web.screenshot(scale="css"))).convert("RGB"))
    return picture


def of_the_way(picture):
    return np.abs(picture - WAY).max(axis=2) < 30


@pytest.mark.parametrize("known", [True, False])
def test_a_way_shows_faded_through_a_floor_and_without_our_front_page_not(seen, known):
    picture = seen(front_page() if known else plain_page())
    way = of_the_way(picture)
    open_half, covered = way[:, : SIZE // 2].sum(), way[:, SIZE // 2 :].sum()
    assert open_half > 300
    if known:
        assert 0.25 * open_half < covered < 0.6 * open_half  # every second pixel of a line a little narrower
    else:
        assert covered == 0
