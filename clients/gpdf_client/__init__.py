"""Light client of the planning service: eclipse-zenoh, msgspec and NumPy, nothing else."""

from gpdf_schemas import Status as Status

from gpdf_client.client import AsyncClient as AsyncClient
from gpdf_client.client import Client as Client
from gpdf_client.results import Certificate as Certificate
from gpdf_client.results import ClientError as ClientError
from gpdf_client.results import DecodeError as DecodeError
from gpdf_client.results import Distances as Distances
from gpdf_client.results import Drawing as Drawing
from gpdf_client.results import InvalidRequestError as InvalidRequestError
from gpdf_client.results import PlanResult as PlanResult
from gpdf_client.results import ServiceBusyError as ServiceBusyError
from gpdf_client.results import ServiceError as ServiceError
from gpdf_client.results import UnavailableError as UnavailableError
from gpdf_client.results import UnknownPlaceError as UnknownPlaceError
from gpdf_client.results import UnknownSceneError as UnknownSceneError
from gpdf_client.trajectory import Trajectory as Trajectory
