"""Lead a simulated person who cannot see through the office.  Usage: python guide.py [ENDPOINT]."""

import sys

import numpy as np
from gpdf_client import Client
from gpdf_guidance import Guide, Planner, Walker, simulate

endpoint = sys.argv[1] if len(sys.argv) > 1 else "tcp/127.0.0.1:7447"
with Client.connect(endpoint) as client:
    guide = Guide(Planner(client, "office"), goal=(5, 3.3))
    floor = 0.0  # the office's floor is flat; elsewhere, the height of the ground at a place
    walker = Walker(np.array([1.0, 1.0, floor]), 2.0, lambda place: floor, np.random.default_rng(0))
    walk = simulate(guide, walker, None)  # with a Truth instead of None, contacts are looked for
    for said in walk.said:
        print(f"{said.time:5.1f} s  {said.text}")
    print(walk.outcome.value)
