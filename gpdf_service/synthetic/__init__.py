"""Seeded scenes with exact truth; they ship with the package, since no real scan can."""

from gpdf_service.synthetic.scenes import SCENES as SCENES
from gpdf_service.synthetic.scenes import SyntheticScene as SyntheticScene
from gpdf_service.synthetic.scenes import ramp as ramp
from gpdf_service.synthetic.scenes import random_room as random_room
from gpdf_service.synthetic.world import Box as Box
from gpdf_service.synthetic.world import Pillar as Pillar
from gpdf_service.synthetic.world import Sphere as Sphere
from gpdf_service.synthetic.world import World as World
