"""Drive a simulated robot along a planned trajectory.  Usage: python drive.py [ENDPOINT]."""

import sys

import numpy as np
from gpdf_client import Client
from gpdf_robot import BODIES, Driver, Errors, Pose, SimulatedRobot, simulate

endpoint = sys.argv[1] if len(sys.argv) > 1 else "tcp/127.0.0.1:7447"
body = BODIES["roomba"]
with Client.connect(endpoint) as client:
    robot = SimulatedRobot(body, Pose(0.9, 0.9, heading=2.0), Errors(), np.random.default_rng(0))
    drive = simulate(Driver(client, "office", (5.4, 3.4), body), robot)
    print(drive.state, f"after {drive.seconds:.0f} s, routes: {drive.plans}, stops: {drive.stops}")
    print(f"within {100 * drive.error_p95:.1f} cm of the line on 95 % of the way")
