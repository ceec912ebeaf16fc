"""A mapper's process whose meshes are never complete, for tests that kill it while it saves a map.

It is started as the function of `vo_service.mapper_process` is.
"""

import signal
from collections.abc import Iterable
from multiprocessing import parent_process
from typing import NoReturn

from drivers.core.process.service_connection import ServiceConnection
from vo_service.config_tables import MapConfig
from vo_service.slam.mapper.mesh_keyframes import MeshKeyframe
from vo_service.slam.mapper.worker import run_mapper


def fuse_until_orphaned(keyframes: Iterable[MeshKeyframe], config: MapConfig) -> NoReturn:
    """Keep the mesh job waiting as long as the mapper's process lives."""
    for _ in keyframes:
        mapper = parent_process()
        assert mapper is not None
        mapper.join()
    while True:  # not reached: an orphan ends at its next keyframe
        signal.pause()


def run(service: ServiceConnection) -> None:
    """Run the mapper."""
    run_mapper(service, fuse_until_orphaned)
