"""Messages and key expressions of the planning service: all that a client needs to know."""

from gpdf_schemas import keys as keys
from gpdf_schemas.codec import MAX_REQUEST_BYTES as MAX_REQUEST_BYTES
from gpdf_schemas.codec import DecodeError as DecodeError
from gpdf_schemas.codec import decode as decode
from gpdf_schemas.codec import encode as encode
from gpdf_schemas.messages import Array as Array
from gpdf_schemas.messages import CertificateMessage as CertificateMessage
from gpdf_schemas.messages import CueAction as CueAction
from gpdf_schemas.messages import CueMessage as CueMessage
from gpdf_schemas.messages import DistanceReply as DistanceReply
from gpdf_schemas.messages import DistanceRequest as DistanceRequest
from gpdf_schemas.messages import LoadRequest as LoadRequest
from gpdf_schemas.messages import ObstaclesMessage as ObstaclesMessage
from gpdf_schemas.messages import PlanReply as PlanReply
from gpdf_schemas.messages import PlanRequest as PlanRequest
from gpdf_schemas.messages import PoseMessage as PoseMessage
from gpdf_schemas.messages import Reply as Reply
from gpdf_schemas.messages import SceneReply as SceneReply
from gpdf_schemas.messages import SceneRequest as SceneRequest
from gpdf_schemas.messages import ScenesReply as ScenesReply
from gpdf_schemas.messages import Status as Status
from gpdf_schemas.messages import TrajectoryMessage as TrajectoryMessage
from gpdf_schemas.messages import UploadRequest as UploadRequest
