"""A mapper's process whose meshes are never complete, for tests that kill it while it saves a map.

It is started as ``vo_service.mapper_process`` is.
"""

import signal
import sys
from collections.abc import Iterable
from multiprocessing import parent_process
from multiprocessing.connection import Connection
from typing import NoReturn

from vo_service.config_tables import MapConfig
from vo_service.slam.mapper.mesh_keyframes import MeshKeyframe
from vo_service.slam.mapper.worker_main import run_mapper


def fuse_until_orphaned(keyframes: Iterable[MeshKeyframe], config: MapConfig) -> NoReturn:
    """Keep the mesh job waiting as long as the mapper's process lives."""
    for _ in keyframes:
        mapper = parent_process()
        assert mapper is not None
        mapper.join()
    while True:  # not reached: an orphan ends at its next keyframe
        signal.pause()


if __name__ == "__main__":
    with Connection(int(sys.argv[1])) as connection:
        run_mapper(connection, fuse_until_orphaned)
