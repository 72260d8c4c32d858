"""Pictures of scenes and plans."""

from gpdf_service.viewer.picture import draw_plans as draw_plans
from gpdf_service.viewer.picture import draw_scene as draw_scene
