"""Explore a room: drive to the next place that is far from all that were reached, until Ctrl-C.

Usage: python explore.py [ENDPOINT]; config/driven.toml simulates a base that takes velocities.
"""

import heapq
import math
import sys
import time

import numpy as np
from scipy.ndimage import distance_transform_edt

from vo_service import InputError, PoseClient

CLEARANCE_M, FAR_M, BLIND_M, SPEED_M_S, TURN_RAD_S = 0.45, 2.0, 0.7, 0.35, 0.7
STEPS = ((0, 1), (1, 0), (0, -1), (-1, 0), (1, 1), (1, -1), (-1, 1), (-1, -1))


def find_path(grid, place_m, reached_m):
    """A*: points in the map to the next place; none if all that is free is near those reached."""
    cells, cell_m = grid.cells[::2, ::2], 2 * grid.resolution_m  # a fourth of the cells is enough
    points_m = (np.dstack(np.indices(cells.shape)[::-1]) + 0.5) * cell_m + grid.origin_xy_m
    away_m = np.min([np.linalg.norm(points_m - each, axis=2) for each in reached_m], axis=0)
    clearance = distance_transform_edt(np.pad(grid.cells != 100, 1))[1:-1:2, 1:-1:2]
    is_known = (cells == 0) | (away_m < BLIND_M)  # the camera did not see the floor at its start
    is_free = is_known & (clearance * grid.resolution_m > CLEARANCE_M)
    remaining = distance_transform_edt(~is_free | (away_m < FAR_M))  # cells, to a place to go to
    free = {tuple(cell) for cell in np.argwhere(is_free).tolist()}
    start = min(free, key=lambda cell: math.dist(points_m[cell], place_m), default=None)
    queue, parents, lengths = [(0.0, start)] if start else [], {start: None}, {start: 0.0}
    while queue and remaining[cell := heapq.heappop(queue)[1]]:
        for step in STEPS:
            near, length = (cell[0] + step[0], cell[1] + step[1]), lengths[cell] + math.hypot(*step)
            if near in free and length < lengths.get(near, math.inf):
                lengths[near], parents[near] = length, cell
                heapq.heappush(queue, (length + remaining[near], near))
    path_m, cell = [], cell if start and not remaining[cell] else None
    while cell:
        path_m, cell = [points_m[cell], *path_m], parents[cell]
    return path_m


try:
    with PoseClient(connect=sys.argv[1] if len(sys.argv) > 1 else "tcp/127.0.0.1:7450") as client:
        next(status for status in client.statuses() if status["map"]["mesh_keyframes"])
        reached_m, path_m = [], []
        for pose in client.poses():
            T = (map_odom := client.map_odom()).T_map_odom @ pose.T_odom_base
            place_m, yaw_rad, turn_rad = T[:2, 3], math.atan2(T[1, 0], T[0, 0]), 1.0
            if not reached_m or 0 < len(path_m) < 4:
                print("reached", place_m.round(2), flush=True)
                reached_m.append(place_m)
            is_in_map = map_odom.is_localized and map_odom.epoch == pose.epoch and not pose.is_lost
            path_m = find_path(client.grid(), place_m, reached_m) if is_in_map else []
            if path_m:  # else it looks around
                x_m, y_m = path_m[:5][-1] - place_m
                turn_rad = math.remainder(math.atan2(y_m, x_m) - yaw_rad, math.tau)
            slower = min(1.0, 0.3 / (time.time() - pose.stamp_s))  # it has moved since the stamp
            forward_m_s = slower * SPEED_M_S * max(1.0 - 2.0 * abs(turn_rad), 0.0)
            client.send_velocity(forward_m_s, slower * TURN_RAD_S * math.tanh(3.0 * turn_rad))
except (InputError, KeyboardInterrupt) as error:
    sys.exit(str(error) or 130)  # 130, as every program that Ctrl-C ends
