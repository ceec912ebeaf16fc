"""Factory of the loop closure. It is imported only when needed: its libraries are slow to load."""

from dataclasses import replace

from vo_service.config_tables import MEGABYTE, MapConfig
from vo_service.slam.loop_closure.loop_closer import LoopCloser
from vo_service.slam.loop_closure.synchronous_loop_closure import SynchronousLoopClosure
from vo_service.slam.place_recognition.keyframe_database import KeyframeDatabase
from vo_service.slam.place_recognition.place_recognizer import PlaceRecognizer
from vo_service.slam.pose_graph.pose_graph import PoseGraph
from vo_service.slam.saved_maps.map_file import MapContents


def create_synchronous_loop_closure(settings: MapConfig) -> SynchronousLoopClosure:
    """Create a loop closure on the caller's thread, with an empty map."""
    return SynchronousLoopClosure(create_loop_closer(settings))


def create_loop_closer(settings: MapConfig) -> LoopCloser:
    """Create a loop closer with an empty map."""
    return LoopCloser(
        PlaceRecognizer(), KeyframeDatabase(settings.keyframe_database_mb * MEGABYTE), PoseGraph()
    )


def create_loop_closer_from_map(contents: MapContents, settings: MapConfig) -> LoopCloser:
    """Create a loop closer with a saved map.

    The map's world frames get negative numbers: new ones are counted from 0.
    """
    saved_ids = sorted({keyframe.world_id for keyframe in contents.keyframes})
    world_ids = {saved_id: rank - len(saved_ids) for rank, saved_id in enumerate(saved_ids)}
    database = KeyframeDatabase(settings.keyframe_database_mb * MEGABYTE)
    for keyframe in contents.keyframes:
        database.add(replace(keyframe, world_id=world_ids[keyframe.world_id]))
    nodes = (replace(node, world_id=world_ids[node.world_id]) for node in contents.nodes)
    graph = PoseGraph(nodes, contents.edges)
    return LoopCloser(PlaceRecognizer(), database, graph, contents.next_number)
