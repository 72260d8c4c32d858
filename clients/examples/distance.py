"""Ask both distance fields at a few places.  Usage: python distance.py [ENDPOINT]."""

import sys

from gpdf_client import Client

endpoint = sys.argv[1] if len(sys.argv) > 1 else "tcp/127.0.0.1:7447"
with Client.connect(endpoint) as client:
    ground = client.distance("office", "ground", [[1.0, 1.0, 0.5], [1.0, 1.0, 2.0]])
    print("over the ground:", ground.distance.round(3), "m")
    room = client.distance("office", "obstacle", [[1.0, 1.0], [90.0, 0.0]], agent="roomba")
    print("beside the Roomba:", room.distance.round(3), "m; known:", room.valid)
