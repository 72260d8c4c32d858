"""Let a scene grow by a scan, hear of its next version, take the scan away.  Usage: python update.py [ENDPOINT]."""

import queue
import sys

import numpy as np
from gpdf_client import Client
from gpdf_schemas import SceneChanged

endpoint = sys.argv[1] if len(sys.argv) > 1 else "tcp/127.0.0.1:7447"
crate = np.random.default_rng(0).uniform((-0.4, -0.4, 0.0), (0.4, 0.4, 1.0), (4000, 3))  # as the sensor sees it
pose = np.array([[0, -1, 0, 3.0], [1, 0, 0, 2.0], [0, 0, 1, 0.0], [0, 0, 0, 1]])  # of the sensor in the scene
with Client.connect(endpoint) as client:
    news: queue.Queue[SceneChanged] = queue.Queue()
    client.load_scene("growing", "office.gpdf", timeout_s=60)
    client.watch_scenes(news.put)
    client.update_scene("growing", crate, pose=pose)
    print("heard of", news.get(timeout=10).scene, "with", client.info("growing")["points"], "points")
    print("without it:", client.update_scene("growing", remove=crate, pose=pose, radius=0.001)["points"])
