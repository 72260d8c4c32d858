"""Tell of something that moves; hear that it is in the way of a plan.  Usage: python obstacles.py [ENDPOINT]."""

import queue
import sys

from gpdf_client import Client
from gpdf_schemas import Cylinder, MovingObstacle, TrajectoryCut

endpoint = sys.argv[1] if len(sys.argv) > 1 else "tcp/127.0.0.1:7447"
with Client.connect(endpoint) as client:
    cuts: queue.Queue[TrajectoryCut] = queue.Queue()
    client.watch_cuts("office", cuts.put)
    plan = client.plan("office", (1, 1), (5, 3.3), agent="roomba")
    x, y, z = plan.trajectory.at_lengths([plan.trajectory.length / 2]).ground[0]
    client.publish_obstacles("office", [MovingObstacle(id="dog", cylinder=Cylinder((x, y, z), 0.2, 0.5), lifetime_s=5)])
    while (cut := cuts.get(timeout=10)).request_id != plan.request_id:  # of others who plan here
        pass
    print("cut by", *cut.obstacles, "after", round(cut.time, 1), "s")
    again = client.plan("office", (1, 1), (5, 3.3), agent="roomba")
    print(again.status, "round it" if again.status == "OK" else again.message)
