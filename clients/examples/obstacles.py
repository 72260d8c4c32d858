"""Tell the planners about somebody who stands in the way.  Usage: python obstacles.py [ENDPOINT]."""

import sys
import time

from gpdf_client import Client
from gpdf_schemas import Cylinder, MovingObstacle

endpoint = sys.argv[1] if len(sys.argv) > 1 else "tcp/127.0.0.1:7447"
visitor = Cylinder(base=(5.0, 3.3, 0.0), radius=0.3, height=1.8)
with Client.connect(endpoint) as client:
    print("before:", client.plan("office", start=(1, 1), goal=(5, 3.3), agent="pepper").status)
    client.publish_obstacles("office", [MovingObstacle(id="visitor", cylinder=visitor, lifetime_s=60.0)])
    time.sleep(0.5)  # a publication is not answered; tell it again while it is there
    print("beside a visitor:", client.plan("office", start=(1, 1), goal=(5, 3.3), agent="pepper").status)
    client.publish_obstacles("office", [MovingObstacle(id="visitor", lifetime_s=0.0)])  # gone
