"""Sample a trajectory by time and by length, cut it, save it.  Usage: python trajectory.py [ENDPOINT]."""

import sys
import tempfile
from pathlib import Path

import numpy as np
from gpdf_client import Client, Trajectory

endpoint = sys.argv[1] if len(sys.argv) > 1 else "tcp/127.0.0.1:7447"
with Client.connect(endpoint) as client, tempfile.TemporaryDirectory() as folder:
    path = client.plan("office", (1, 1), (5, 3.3), "human").trajectory
    print("where after 2 s:", path.at_times([2.0]).ground[0].round(2))
    print("every metre:", path.at_lengths(np.arange(0, path.length, 1.0)).ground.round(2).tolist())
    first = path.cut(0.0, 1.0)
    for name in ("first.json", "first.csv", "first.geojson"):
        first.save(Path(folder, name))
    print(f"the first {Trajectory.load(Path(folder, 'first.json')).length:.2f} m take {first.duration:.2f} s")
