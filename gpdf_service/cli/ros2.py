"""`gpdf ros2 SCENE --agent …`: answer the goals of a ROS 2 robot with paths, without ROS here."""

from __future__ import annotations

import argparse
import logging
import signal
import sys
import threading

import zenoh
from gpdf_client import Client, ClientError
from gpdf_client.cli import add_connection, connect
from gpdf_ros2 import Bridge, Dialect, Names

from gpdf_service.types import resolve_agent


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the verb's options."""
    names = Names()
    parser.add_argument("scene", help="a scene of the service")
    parser.add_argument("--agent", default="roomba", help="the robot's body")
    add_connection(parser)
    parser.add_argument("--ros-endpoint", help="the router of rmw_zenoh, or the bridge; the service's when not given")
    parser.add_argument(
        "--dialect",
        default=Dialect.RMW_ZENOH,
        choices=list(Dialect),
        type=Dialect,
        help="of the robot's bridge to Zenoh",
    )
    parser.add_argument("--domain", type=int, default=0, help="ROS_DOMAIN_ID")
    parser.add_argument("--goal-topic", default=names.goal, help="PoseStamped in: where to go")
    parser.add_argument("--pose-topic", default=names.pose, help="PoseStamped in: where the robot is")
    parser.add_argument("--path-topic", default=names.path, help="Path out; empty where there is none")
    parser.add_argument("--cloud-topic", default=names.cloud, help="PointCloud2 in: becomes the scene")
    parser.add_argument("--frame", default=names.frame, help="the scene's frame")


def run(args: argparse.Namespace) -> int:
    """Answer until SIGINT or SIGTERM."""
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(levelname)s %(name)s: %(message)s")
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    resolve_agent(args.agent)
    names = Names(args.goal_topic, args.pose_topic, args.path_topic, args.cloud_topic, args.frame)
    try:
        with (
            connect(args) as client,
            Client.connect(args.ros_endpoint) if args.ros_endpoint else connect(args) as ros,
            Bridge(client, ros.session, args.scene, args.agent, names=names, dialect=args.dialect, domain=args.domain),
        ):
            stop.wait()
    except (ClientError, ValueError, zenoh.ZError) as error:
        print(f"gpdf: {error}", file=sys.stderr)
        return 1
    return 0
