"""The status of kinect-vo as tasks of ROS's diagnostics."""

import json
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import pytest
from kinect_vo_ros2.diagnostics import Diagnostics, Level, Task, no_status

from drivers.camera import CameraState
from tests.vo_service.fakes import make_status
from vo_service.types.messages import encode_message
from vo_service.types.odometry_update import TrackingState


def status(**changes: Any) -> Mapping[str, Any]:
    content: Mapping[str, Any] = json.loads(encode_message(make_status(**changes)))
    return content


def tasks(*statuses: Mapping[str, Any]) -> dict[str, Task]:
    diagnostics = Diagnostics()
    found = [diagnostics.tasks(each) for each in statuses]
    return {task.name: task for task in found[-1]}


@pytest.mark.parametrize(
    ("state", "level"),
    [
        (TrackingState.TRACKING, Level.OK),
        (TrackingState.DEGRADED, Level.WARN),
        (TrackingState.LOST, Level.ERROR),
        (TrackingState.NO_CAMERA, Level.ERROR),
    ],
)
def test_the_state_of_tracking_has_a_level(state: TrackingState, level: Level) -> None:
    task = tasks(status(state=state, reason="few inliers"))["tracking"]
    assert (task.level, task.message) == (level, f"{state}: few inliers")
    assert task.values["tracking.method"]


def test_paused_is_a_warning() -> None:
    task = tasks(status(state=TrackingState.TRACKING, reason="", paused=True))["tracking"]
    assert (task.level, task.message) == (Level.WARN, "paused; tracking")


@pytest.mark.parametrize("state", CameraState)
def test_every_state_of_a_camera_has_a_level(state: CameraState) -> None:
    camera = replace(make_status().camera, state=state)
    task = tasks(status(camera=camera))["camera"]
    assert (task.level is Level.OK) == (state is CameraState.STREAMING)
    assert task.message == state


def test_frames_that_were_dropped_since_the_last_message_are_a_warning() -> None:
    def dropped(count: int) -> Mapping[str, Any]:
        return status(camera=replace(make_status().camera, dropped=count))

    assert tasks(dropped(9))["timing"].level is Level.OK  # before this node's start
    assert tasks(dropped(9), dropped(11))["timing"].message == "2 frames dropped"
    assert tasks(dropped(9), dropped(11), dropped(11))["timing"].level is Level.OK
    assert tasks(dropped(9), dropped(0))["timing"].level is Level.OK  # a restart


def test_warnings_of_the_service_are_joined() -> None:
    task = tasks(status(warnings=("no disk", "no router")))["service"]
    assert (task.level, task.message) == (Level.WARN, "no disk; no router")


def test_without_a_status_the_service_is_an_error() -> None:
    assert no_status(None).level is Level.ERROR
    assert "no status for 3 s" in no_status(3.2).message
