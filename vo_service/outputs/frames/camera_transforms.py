"""The fixed transforms of a camera on a robot, with the frames of ROS drivers."""

import numpy as np

from drivers.core.geometry import T_BODY_CAMERA, Array, inverse
from drivers.ros_messages.navigation import TransformMessage

_COLOR_SUFFIX = "_rgb_optical_frame"


def camera_transforms(
    stamp_s: float, base_frame_id: str, camera_frame_id: str, T_base_camera: Array
) -> list[TransformMessage]:
    """Make the transforms from the base to the camera's frames.

    For the frame NAME_rgb_optical_frame these are NAME_link, NAME_rgb_frame and NAME_depth_frame,
    with x forward, and NAME_depth_optical_frame, as in openni2_camera. Depth is registered to
    color, so the frames of both have one origin. A frame of another name gets one transform.

    Args:
        T_base_camera: 4x4 pose of the optical camera in the base, meters.
    """
    if not camera_frame_id.endswith(_COLOR_SUFFIX):
        return [TransformMessage(stamp_s, base_frame_id, camera_frame_id, T_base_camera)]
    name = camera_frame_id.removesuffix(_COLOR_SUFFIX)
    link = f"{name}_link"
    transforms = [
        TransformMessage(stamp_s, base_frame_id, link, T_base_camera @ inverse(T_BODY_CAMERA))
    ]
    for image in ("rgb", "depth"):
        body, optical = f"{name}_{image}_frame", f"{name}_{image}_optical_frame"
        transforms += [
            TransformMessage(stamp_s, link, body, np.eye(4)),
            TransformMessage(stamp_s, body, optical, T_BODY_CAMERA),
        ]
    return transforms
