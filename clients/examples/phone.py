"""A phone elsewhere: poses out, words in, with zenoh and msgpack alone.  Usage: python phone.py [ENDPOINT [NAME]]."""

import sys
import time

import msgpack
import zenoh

endpoint = sys.argv[1] if len(sys.argv) > 1 else "tcp/127.0.0.1:7447"
name = sys.argv[2] if len(sys.argv) > 2 else "anna"
config, answered = zenoh.Config(), set()
config.insert_json5("mode", '"client"')
config.insert_json5("connect/endpoints", f'["{endpoint}"]')


def speak(sample: zenoh.Sample) -> None:
    said = msgpack.unpackb(sample.payload.to_bytes())
    if time.time() <= said["valid_until"]:  # later, it is wrong
        print("answer:" if said["reply_to"] else "guide:", said["text"])
        answered.add(said["reply_to"])


with zenoh.open(config) as session:
    session.declare_subscriber(f"gpdf/v1/say/{name}", speak)  # and gpdf/v1/cue/NAME: none for 0.5 s means stop
    while not answered - {""}:  # as long as one walks; here, until it is answered
        pose = {"position": [1.0, 1.0, 0.0], "heading": 0.5, "stamp": time.time(), "accuracy": 0.02}
        session.put(f"gpdf/v1/pose/{name}", msgpack.packb(pose))
        if int(10.0 * time.time()) % 20 < 2:  # again, if nobody hears it
            session.put(f"gpdf/v1/ask/{name}", msgpack.packb({"ask": "where", "id": "1"}))
        time.sleep(0.1)
