"""Zenoh's configuration of a service: a router where it listens, a peer of somebody's router where it does not."""

from __future__ import annotations

import json
import os

import zenoh
from gpdf_client.client import LEASE_MS, RETRY

from gpdf_service.errors import ConfigError
from gpdf_service.service.options import Options

MAX_MESSAGE_BYTES = 32 << 20
"""What one client may make the router hold at once; Zenoh drops what is longer, where its own limit is 1 GiB."""


PATIENCE_US = 1_000_000
"""[µs] A link that takes nothing of what is sent for so long is closed: 64 kB, at half a megabit a second."""
RUNTIME = "(rx: (worker_threads: 16), tx: (worker_threads: 16))"
"""Zenoh's threads for links: some wait while a link takes nothing, and of one or two none is left for the others."""


def _is_encrypted(endpoint: str) -> bool:
    """Whether who connects there shows a certificate; nobody connects where there is no endpoint."""
    return not endpoint or endpoint.partition("/")[0] in ("tls", "quic", "wss")


def set_up_threads() -> None:
    """Before the process opens its first session; what the operator has set stays."""
    os.environ.setdefault("ZENOH_RUNTIME", RUNTIME)


def session_config(options: Options) -> zenoh.Config:
    """What to open; the operator's file first (credentials, certificates, rights), then what we must have.

    Raises:
        ConfigError: it asks for certificates where nobody would have to show one.
    """
    config = zenoh.Config() if options.zenoh is None else zenoh.Config.from_file(str(options.zenoh))
    if json.loads(config.get_json("transport/link/tls/enable_mtls")) and not _is_encrypted(options.endpoint):
        found = f"{options.endpoint} asks nobody for a certificate, but {options.zenoh} wants one of everybody"
        raise ConfigError("serve.endpoint", found, "Listen on tls/HOST:PORT, or leave enable_mtls out.")
    values = {
        "mode": "router" if options.endpoint else "peer",
        "listen/endpoints": [options.endpoint] if options.endpoint else [],
        "connect/endpoints": list(options.connect),
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "transport/link/rx/max_message_size": MAX_MESSAGE_BYTES,
        "transport/link/tx/lease": LEASE_MS,
        "transport/link/tx/queue/congestion_control/block/wait_before_close": PATIENCE_US,
        "connect/retry": RETRY,
    }
    for key, value in values.items():
        config.insert_json5(key, json.dumps(value))
    return config
