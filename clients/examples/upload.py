"""Send a cloud to the service, plan in it, let it go again.  Usage: python upload.py [ENDPOINT]."""

import sys

import numpy as np
from gpdf_client import Client

x, y = np.meshgrid(np.arange(0, 6, 0.04), np.arange(0, 4, 0.04))
floor = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
endpoint = sys.argv[1] if len(sys.argv) > 1 else "tcp/127.0.0.1:7447"
with Client.connect(endpoint) as client:
    facts = client.load_scene("terrace", upload=floor)
    print(facts["points"], "points, the ground is", round(facts["levels"][0]["known_area"], 1), "m²")
    print(client.plan("terrace", start=(1, 1), goal=(5, 3), agent="spot").status)
    client.unload_scene("terrace")
