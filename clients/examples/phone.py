"""A phone elsewhere: poses out, words in, with zenoh and msgpack alone.  Usage: python phone.py [ENDPOINT [NAME]]."""

import sys
import time

import msgpack
import zenoh

endpoint = sys.argv[1] if len(sys.argv) > 1 else "tcp/127.0.0.1:7447"
name = sys.argv[2] if len(sys.argv) > 2 else "anna"
config = zenoh.Config.from_json5(f'{{mode: "client", connect: {{endpoints: ["{endpoint}"]}}}}')
answered = set()


def speak(sample: zenoh.Sample) -> None:
    said = msgpack.unpackb(sample.payload.to_bytes())
    if time.time() <= said["valid_until"]:  # later, it is wrong
        print(said["reply_to"], said["text"], "(answer: yes or no)" if said["answers"] else "")
        answered.add(said["reply_to"])


with zenoh.open(config) as session:
    session.declare_subscriber(f"gpdf/v1/say/{name}", speak)
    session.declare_subscriber(f"gpdf/v1/cue/{name}", lambda sample: None)  # vibrate here; none for 0.5 s means stop
    while "where am I:" not in answered:  # or as long as one walks
        pose = {"position": [1.0, 1.0, 0.0], "heading": 0.5, "stamp": time.time(), "accuracy": 0.02}
        session.put(f"gpdf/v1/pose/{name}", msgpack.packb(pose))
        if time.time() % 2.0 < 0.1:  # again, as nobody may have heard it
            session.put(f"gpdf/v1/ask/{name}", msgpack.packb({"ask": "where", "id": "where am I:"}))
        time.sleep(0.1)
