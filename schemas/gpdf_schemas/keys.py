"""Key expressions. A request is a Zenoh query with a msgpack map as payload; its reply is one on the same key."""

ROOT = "gpdf/v1"
PLAN = f"{ROOT}/plan"
DISTANCE = f"{ROOT}/distance"
SCENES = f"{ROOT}/scenes"
SCENE_INFO = f"{ROOT}/scene/info"
SCENE_LOAD = f"{ROOT}/scene/load"
SCENE_UPLOAD = f"{ROOT}/scene/upload"
SCENE_UNLOAD = f"{ROOT}/scene/unload"
SCENE_UPDATE = f"{ROOT}/scene/update"
SCENE_PLACES = f"{ROOT}/scene/places"
"""The named places of a scene."""
SCENE_PLACE = f"{ROOT}/scene/place"
"""Name one, or forget it; a key of its own, so that rights can tell readers from writers."""
POSE = f"{ROOT}/pose"
"""Stream of poses (`PoseMessage`); below it, the name of the body."""
CUE = f"{ROOT}/cue"
"""Stream of haptic cues (`CueMessage`); below it, the name of the body."""
SAY = f"{ROOT}/say"
"""Stream of sentences (`SayMessage`); below it, the name of the person who is guided."""
ASK = f"{ROOT}/ask"
"""Stream of what a person asks the guide (`AskMessage`); below it, the name of the person."""
VELOCITY = f"{ROOT}/velocity"
"""Stream of velocity commands (`VelocityMessage`); below it, the name of the body."""
SCENE_DRAW = f"{ROOT}/scene/draw"
ALIVE = f"{ROOT}/alive"
"""Liveliness token of a service; below it, the service's id."""
SCENE_FILE = f"{ROOT}/scene/file"
"""Parts of a ready scene's file, for planners on other machines."""
MAP_ALIVE = f"{ROOT}/map/alive"
"""Liveliness token of a map service; below it, the service's id."""
STATUS = f"{ROOT}/service"
"""Below it, the service's id, then "status"; ask `gpdf/v1/service/*/status` of all (query target ALL)."""


def of_planner(planner: str, key: str) -> str:
    """The key on which one planner alone answers what all answer on `key` (PLAN or DISTANCE)."""
    return f"{ROOT}/planner/{planner}/{key.removeprefix(ROOT + '/')}"


def status_of(service: str) -> str:
    """The key of a service's health, readiness and metrics; "*" names all."""
    return f"{STATUS}/{service}/status"


def changed(scene: str) -> str:
    """Where a new version of a scene, or its end, is published; "*" names all."""
    return f"{SCENES}/{scene}/changed"


def obstacles(scene: str) -> str:
    """Where to publish what moves in a scene, as `MovingObstacles`; "*" names all."""
    return f"{SCENES}/{scene}/obstacles"


def cut(scene: str) -> str:
    """Where it is published that a trajectory is not clear any more, as `TrajectoryCut`."""
    return f"{SCENES}/{scene}/cut"
