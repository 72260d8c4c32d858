"""Zenoh's configuration of a service: a router where it listens, a peer of somebody's router where it does not."""

from __future__ import annotations

import json

import zenoh

from gpdf_service.service.options import Options

MAX_MESSAGE_BYTES = 32 << 20
"""What one client may make the router hold at once; Zenoh drops what is longer, where its own limit is 1 GiB."""
LEASE_MS = 2_000
"""[ms] A frozen process counts as dead after this; one that is killed, at once."""


def session_config(options: Options) -> zenoh.Config:
    """What to open; the operator's file first (credentials, certificates, rights), then what we must have."""
    config = zenoh.Config() if options.zenoh is None else zenoh.Config.from_file(str(options.zenoh))
    values = {
        "mode": "router" if options.endpoint else "peer",
        "listen/endpoints": [options.endpoint] if options.endpoint else [],
        "connect/endpoints": list(options.connect),
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "transport/link/rx/max_message_size": MAX_MESSAGE_BYTES,
        "transport/link/tx/lease": LEASE_MS,
    }
    for key, value in values.items():
        config.insert_json5(key, json.dumps(value))
    return config
