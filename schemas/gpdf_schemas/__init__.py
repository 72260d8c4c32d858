"""Messages and key expressions of the planning service: all that a client needs to know."""

from gpdf_schemas import keys as keys
from gpdf_schemas.codec import MAX_REQUEST_BYTES as MAX_REQUEST_BYTES
from gpdf_schemas.codec import DecodeError as DecodeError
from gpdf_schemas.codec import decode as decode
from gpdf_schemas.codec import encode as encode
from gpdf_schemas.messages import Array as Array
from gpdf_schemas.messages import CertificateMessage as CertificateMessage
from gpdf_schemas.messages import Cylinder as Cylinder
from gpdf_schemas.messages import DistanceReply as DistanceReply
from gpdf_schemas.messages import DistanceRequest as DistanceRequest
from gpdf_schemas.messages import FileReply as FileReply
from gpdf_schemas.messages import FileRequest as FileRequest
from gpdf_schemas.messages import LoadRequest as LoadRequest
from gpdf_schemas.messages import MovingObstacle as MovingObstacle
from gpdf_schemas.messages import MovingObstacles as MovingObstacles
from gpdf_schemas.messages import PlanReply as PlanReply
from gpdf_schemas.messages import PlanRequest as PlanRequest
from gpdf_schemas.messages import Reply as Reply
from gpdf_schemas.messages import SceneChanged as SceneChanged
from gpdf_schemas.messages import SceneReply as SceneReply
from gpdf_schemas.messages import SceneRequest as SceneRequest
from gpdf_schemas.messages import ScenesReply as ScenesReply
from gpdf_schemas.messages import Status as Status
from gpdf_schemas.messages import StatusReply as StatusReply
from gpdf_schemas.messages import TrajectoryMessage as TrajectoryMessage
from gpdf_schemas.messages import UploadRequest as UploadRequest
