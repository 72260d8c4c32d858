"""Hear of services that come and go, and how they are.  Usage: python services.py [ENDPOINT]."""

import sys
import threading

from gpdf_client import Client

endpoint = sys.argv[1] if len(sys.argv) > 1 else "tcp/127.0.0.1:7447"
heard = threading.Event()
with Client.connect(endpoint) as client:
    client.watch(lambda service, there: (print("is there:" if there else "is gone:", service), heard.set()))
    heard.wait(timeout=10)
    for service in client.status():
        print(service.role, "healthy:", service.healthy, "ready:", service.ready, "load:", service.load)
