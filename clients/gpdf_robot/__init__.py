"""A robot's front end: follows trajectories of the service, looks ahead, stops, asks again; and a simulated robot."""

from gpdf_robot.bodies import BODIES as BODIES
from gpdf_robot.bodies import Body as Body
from gpdf_robot.drive import Drive as Drive
from gpdf_robot.drive import simulate as simulate
from gpdf_robot.driver import Driver as Driver
from gpdf_robot.driver import State as State
from gpdf_robot.live import drive_live as drive_live
from gpdf_robot.motion import Pose as Pose
from gpdf_robot.motion import Velocity as Velocity
from gpdf_robot.simulator import Errors as Errors
from gpdf_robot.simulator import SimulatedRobot as SimulatedRobot
