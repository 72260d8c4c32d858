"""Wait for a service, load a file of its scenes folder, list what it has.  Usage: python scenes.py [ENDPOINT]."""

import sys

from gpdf_client import Client

endpoint = sys.argv[1] if len(sys.argv) > 1 else "tcp/127.0.0.1:7447"
with Client.connect(endpoint) as client:
    client.wait_for_service(timeout_s=10)
    client.load_scene("copy", "office.gpdf", timeout_s=60)
    for name, facts in client.scenes().items():
        print(name, "version", facts.get("version"), "building" if facts["building"] else "")
    facts = client.wait_for_scene("copy", timeout_s=60)
    print(facts["points"], "points on", len(facts["levels"]), "level")
    print("digest", client.info("copy")["digest"])
    client.unload_scene("copy")
