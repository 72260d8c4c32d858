"""`python -m gpdf_schemas.generate FOLDER` writes the JSON Schema of every message."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import msgspec

from gpdf_schemas import messages, speech

MESSAGES = (
    messages.PlanRequest,
    messages.PlanReply,
    messages.DistanceRequest,
    messages.DistanceReply,
    messages.SceneRequest,
    messages.SceneReply,
    messages.ScenesReply,
    messages.LoadRequest,
    messages.UploadRequest,
    messages.UpdateRequest,
    messages.PlaceRequest,
    messages.PlacesReply,
    messages.PoseMessage,
    messages.CueMessage,
    speech.SayMessage,
    speech.AskMessage,
    messages.VelocityMessage,
    messages.FileRequest,
    messages.FileReply,
    messages.StatusReply,
    messages.SceneChanged,
    messages.MovingObstacles,
    messages.TrajectoryCut,
    messages.DrawRequest,
    messages.DrawReply,
)


def schema_of(kind: type[Any]) -> str:
    """JSON Schema of one message, as text."""
    return json.dumps(msgspec.json.schema(kind), indent=2, sort_keys=True) + "\n"


def main(folder: Path) -> None:
    """Write one file a message."""
    folder.mkdir(parents=True, exist_ok=True)
    for kind in MESSAGES:
        (folder / f"{kind.__name__}.json").write_text(schema_of(kind))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
