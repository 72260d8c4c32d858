"""Fetch what a picture of a scene shows, thinned to what it bears.  Usage: python drawing.py [ENDPOINT]."""

import sys

from gpdf_client import Client

endpoint = sys.argv[1] if len(sys.argv) > 1 else "tcp/127.0.0.1:7447"
with Client.connect(endpoint) as client:
    cloud = client.draw("office", "cloud", limit=10_000)
    points = cloud.origin + cloud.places
    print(len(points), "points between", points.min(axis=0).round(1), "and", points.max(axis=0).round(1))
    leaves = client.draw("office", "leaves", agent="roomba")
    print(len(leaves.places), "leaves of free space; of each:", ", ".join(leaves.columns))
