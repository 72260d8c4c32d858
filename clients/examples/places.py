"""Name places once, plan by their names.  Usage: python places.py [ENDPOINT]."""

import sys

from gpdf_client import Client, UnknownPlaceError

endpoint = sys.argv[1] if len(sys.argv) > 1 else "tcp/127.0.0.1:7447"
with Client.connect(endpoint) as client:
    client.set_place("office", "entrance", (1.0, 1.0))
    client.set_place("office", "kitchen", (5.0, 3.3))
    print(", ".join(f"{name} at {place}" for name, place in client.places("office").items()))
    print(client.plan("office", start="entrance", goal="kitchen").status)
    print("the kitchen is at", client.where("office", "kitchen"))
    print("left:", client.remove_place("office", "kitchen"))
    try:
        client.plan("office", start="entrance", goal="kitchen")
    except UnknownPlaceError as error:
        print(error)
