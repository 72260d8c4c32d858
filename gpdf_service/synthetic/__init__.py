"""Seeded scenes with exact truth; they ship with the package, since no real scan can."""

from gpdf_service.synthetic.houses import house as house
from gpdf_service.synthetic.place import Place as Place
from gpdf_service.synthetic.scanners import SCANNERS as SCANNERS
from gpdf_service.synthetic.scanners import Scan as Scan
from gpdf_service.synthetic.scenes import SCENES as SCENES
from gpdf_service.synthetic.scenes import SyntheticScene as SyntheticScene
from gpdf_service.synthetic.scenes import ramp as ramp
from gpdf_service.synthetic.scenes import random_room as random_room
from gpdf_service.synthetic.solid_world import SolidWorld as SolidWorld
from gpdf_service.synthetic.stairs import STAIRS as STAIRS
from gpdf_service.synthetic.world import Box as Box
from gpdf_service.synthetic.world import Pillar as Pillar
from gpdf_service.synthetic.world import Sphere as Sphere
from gpdf_service.synthetic.world import World as World
