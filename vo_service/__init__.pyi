"""The public names of the service and of the library."""

from drivers.core.errors import InputError as InputError
from vo_service.client.connection import CommandRefused as CommandRefused
from vo_service.client.connection import FrameUnavailable as FrameUnavailable
from vo_service.client.connection import PoseUnavailable as PoseUnavailable
from vo_service.client.connection import PoseUnavailableReason as PoseUnavailableReason
from vo_service.client.connection import ServiceUnavailable as ServiceUnavailable
from vo_service.client.frame_client import Frame as Frame
from vo_service.client.frame_client import FrameClient as FrameClient
from vo_service.client.frame_client import PointCloud as PointCloud
from vo_service.client.frame_client import Scan as Scan
from vo_service.client.pose import MapOdom as MapOdom
from vo_service.client.pose import Pose as Pose
from vo_service.client.pose_client import PoseClient as PoseClient
from vo_service.odometry.registry import METHODS as METHODS
from vo_service.odometry.registry import make_odometry as make_odometry
from vo_service.types.estimate import Estimate as Estimate
from vo_service.types.odometry import Odometry as Odometry
