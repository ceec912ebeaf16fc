"""The optimized trajectory moves with its keyframes."""

import numpy as np

from drivers.core.geometry import inverse, rigid_transform
from vo_service.slam.graph_edges import Edge
from vo_service.slam.pose_graph import NodeRemoval, OptimizedTrajectory, PoseGraph

AHEAD = rigid_transform(np.eye(3), [0.0, 0.0, 1.0])
SURE, VAGUE = np.eye(6) * 1e-8, np.eye(6) * 1e-2


def graph() -> PoseGraph:
    """Two keyframes, the second a meter ahead by the odometry."""
    made = PoseGraph()
    made.add_node(0, 0, np.eye(4))
    made.add_odometry_edge(Edge(0, 1, AHEAD, VAGUE, False, 1.0))
    return made


def test_frames_move_with_the_previous_keyframe() -> None:
    keyframes = graph()
    optimized = OptimizedTrajectory(keyframes)
    optimized.add(1.0, 0, np.eye(4))
    optimized.add(2.0, 1, AHEAD)
    further = rigid_transform(np.eye(3), [0.0, 0.0, 1.1])
    keyframes.add_loop_closure(Edge(0, 1, further, SURE, True, 0.0))
    keyframes.optimize()
    found = optimized.trajectory
    assert found.stamps_s.tolist() == [1.0, 2.0]
    assert np.allclose(found.T_world_camera[1][:3, 3], [0.0, 0.0, 2.1], atol=1e-3)


def test_the_first_pose_is_identity_and_stamps_increase() -> None:
    optimized = OptimizedTrajectory(graph())
    assert len(optimized.trajectory) == 0
    for stamp_s in (3.0, 1.0, 2.0):
        optimized.add(stamp_s, 1, np.linalg.matrix_power(AHEAD, int(stamp_s)))
    found = optimized.trajectory
    assert found.stamps_s.tolist() == [1.0, 2.0, 3.0]
    assert np.allclose(found.T_world_camera[0], np.eye(4))
    assert np.allclose(found.T_world_camera[2], AHEAD @ AHEAD)


def test_frames_of_a_removed_keyframe_stay() -> None:
    keyframes = graph()
    optimized = OptimizedTrajectory(keyframes)
    optimized.add(1.0, 0, np.eye(4))
    optimized.add(2.0, 1, AHEAD)
    optimized.re_anchor(keyframes.remove_node(1))
    assert np.allclose(optimized.trajectory.T_world_camera[1][:3, 3], [0.0, 0.0, 2.0])
    optimized.re_anchor(NodeRemoval(0, None, np.eye(4)))
    keyframes.remove_node(0)
    assert np.allclose(inverse(optimized.trajectory.T_world_camera[0]), np.eye(4))


def test_of_frames_with_one_stamp_the_last_is_kept_after_a_keyframe_removal() -> None:
    keyframes = graph()
    optimized = OptimizedTrajectory(keyframes)
    optimized.add(1.0, 0, np.eye(4))
    optimized.add(2.0, 1, AHEAD @ AHEAD)
    optimized.add(2.0, 0, AHEAD)
    optimized.re_anchor(keyframes.remove_node(1))
    found = optimized.trajectory
    assert found.stamps_s.tolist() == [1.0, 2.0]
    assert np.allclose(found.T_world_camera[1], AHEAD)


def test_frames_are_moved_from_neighbor_to_neighbor() -> None:
    keyframes = graph()
    keyframes.add_odometry_edge(Edge(1, 2, AHEAD, VAGUE, False, 1.0))
    optimized = OptimizedTrajectory(keyframes)
    optimized.add(1.0, 0, np.eye(4))
    optimized.add(2.0, 2, AHEAD)
    for number in (2, 1):
        optimized.re_anchor(keyframes.remove_node(number))
    assert np.allclose(optimized.trajectory.T_world_camera[1][:3, 3], [0.0, 0.0, 3.0])
