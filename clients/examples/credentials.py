"""Connect with a configuration of your own.  Usage: python credentials.py [ENDPOINT [USER PASSWORD]]."""

import json
import sys

import zenoh
from gpdf_client import Client

endpoint = sys.argv[1] if len(sys.argv) > 1 else "tcp/127.0.0.1:7447"
config = zenoh.Config()  # or zenoh.Config.from_file("client.json5")
config.insert_json5("mode", '"client"')
config.insert_json5("connect/endpoints", json.dumps([endpoint]))
if len(sys.argv) > 3:  # a service without users refuses those who name one
    config.insert_json5("transport/auth/usrpwd/user", json.dumps(sys.argv[2]))
    config.insert_json5("transport/auth/usrpwd/password", json.dumps(sys.argv[3]))
with Client.connect(config=config) as client:
    print(sorted(client.scenes()))
