"""ROS 2 without ROS: goals in, paths out, clouds in, as CDR on the keys of rmw_zenoh or zenoh-bridge-ros2dds."""

from gpdf_ros2.bridge import Bridge as Bridge
from gpdf_ros2.bridge import Names as Names
from gpdf_ros2.topics import Dialect as Dialect
from gpdf_ros2.topics import Topic as Topic
