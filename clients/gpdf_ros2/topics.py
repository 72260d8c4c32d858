"""Where ROS 2's topics are in Zenoh's key space, and what goes with a message.

Two dialects, both with CDR as payload:

- rmw_zenoh, for ROS 2 nodes that run on Zenoh (github.com/ros2/rmw_zenoh, docs/design.md, "Topic and Service name
  mapping to Zenoh key expressions" and "Publishers", commit 99a6a2b): the key is
  `<domain>/<topic>/<type>/<hash>`, the type as DDS names it, the hash as REP-2016 defines it; each message carries an
  attachment of 33 bytes (attachment_helpers.cpp, commit 534747d, by zenoh-ext's serialiser): sequence number and time
  [ns] as little-endian int64, the length 16, and 16 bytes that name the publisher. A subscription drops messages
  without it (rmw_subscription_data.cpp, commit a72659a). Liveliness tokens show node and topics to `ros2 topic list`.
- ros2dds, for nodes on DDS behind zenoh-bridge-ros2dds (github.com/eclipse-zenoh/zenoh-plugin-ros2dds, README.md and
  examples/python/src/listener.py): the key is the topic's name without its first slash, behind the bridge's
  namespace if it has one; no attachment.
"""

from __future__ import annotations

import hashlib
import re
import struct
from dataclasses import dataclass
from enum import StrEnum

QOS = "::,10:,:,:,,"
"""rmw_zenoh's short form of the default profile with a depth of 10: reliable, volatile, keep last."""
NODE = "gpdf"
NAME = re.compile(r"/?[A-Za-z_~][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")
"""A topic's name, design.ros2.org/articles/topic_and_service_names.html."""


class Dialect(StrEnum):
    """How ROS 2 comes to Zenoh."""

    RMW_ZENOH = "rmw_zenoh"
    ROS2DDS = "ros2dds"


@dataclass(frozen=True, slots=True)
class Topic:
    """A ROS 2 topic.

    Attributes:
        name: With its namespace, as `/robot1/plan`.
        type: As `nav_msgs/msg/Path`.
        hash: Of the type's definition, as `RIHS01_…`.
    """

    name: str
    type: str
    hash: str

    def __post_init__(self) -> None:
        if not NAME.fullmatch(self.name):
            raise ValueError(f"{self.name!r} is no name of a topic. Write it as /robot1/plan.")

    @property
    def dds_type(self) -> str:
        """The type's name in DDS."""
        package, kind, name = self.type.split("/")
        return f"{package}::{kind}::dds_::{name}_"

    def key(self, dialect: Dialect, domain: int = 0) -> str:
        """Its key expression.

        Args:
            dialect: How ROS 2 comes to Zenoh.
            domain: ROS_DOMAIN_ID; part of rmw_zenoh's keys alone.
        """
        name = self.name.strip("/")
        return name if dialect is Dialect.ROS2DDS else f"{domain}/{name}/{self.dds_type}/{self.hash}"

    def token(self, kind: str, session: str, entity: int, domain: int = 0) -> str:
        """The liveliness token that shows a publisher ("MP") or a subscription ("MS") of ours to rmw_zenoh."""
        name = "%" + self.name.strip("/").replace("/", "%")
        place = f"@ros2_lv/{domain}/{session}/0/{entity}/{kind}/%/%/{NODE}"
        return f"{place}/{name}/{self.dds_type}/{self.hash}/{QOS}"


def node_token(session: str, domain: int = 0) -> str:
    """The liveliness token that shows our node to rmw_zenoh."""
    return f"@ros2_lv/{domain}/{session}/0/0/NN/%/%/{NODE}"


def publisher_id(token: str) -> bytes:
    """16 bytes that name a publisher: a hash of its token. rmw_zenoh takes XXH3; each only has to have another."""
    return hashlib.blake2b(token.encode(), digest_size=16).digest()


def attachment(sequence: int, stamp_ns: int, publisher: bytes) -> bytes:
    """What rmw_zenoh wants beside each message."""
    return struct.pack("<qqB16s", sequence, stamp_ns, len(publisher), publisher)
