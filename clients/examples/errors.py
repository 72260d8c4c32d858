"""What can go wrong, and how it is told apart.  Usage: python errors.py [ENDPOINT]."""

import sys

from gpdf_client import Client, ClientError, InvalidRequestError, UnknownSceneError

endpoint = sys.argv[1] if len(sys.argv) > 1 else "tcp/127.0.0.1:7447"
with Client.connect(endpoint) as client:
    print("no path is a result:", client.plan("office", (1, 1), (90, 2)).status)
    for scene, agent in (("nowhere", "human"), ("office", "dragon")):
        try:
            client.plan(scene, (1, 1), (5, 3.3), agent)
        except UnknownSceneError as error:
            print("another scene:", error)
        except InvalidRequestError as error:
            print("another request:", error)
        except ClientError as error:  # the root of them all: nobody there, busy, failed
            print("later:", error)
