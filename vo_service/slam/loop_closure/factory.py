"""Making the loops: where they are asked for, since their libraries are slow to load."""

from dataclasses import replace

from vo_service.config_tables import MEGABYTE, MapConfig
from vo_service.slam.loop_closure.loop_closer import LoopCloser
from vo_service.slam.loop_closure.synchronous_loop_closure import SynchronousLoopClosure
from vo_service.slam.place_recognition.keyframe_database import KeyframeDatabase
from vo_service.slam.place_recognition.place_recognizer import PlaceRecognizer
from vo_service.slam.pose_graph.pose_graph import PoseGraph
from vo_service.slam.saved_maps.map_file import MapContents


def create_synchronous_loop_closure(settings: MapConfig) -> SynchronousLoopClosure:
    """Loops on the caller's own thread, that know no place yet."""
    return SynchronousLoopClosure(create_loop_closer(settings))


def create_loop_closer(settings: MapConfig) -> LoopCloser:
    """A loop closer that knows no place yet."""
    return LoopCloser(
        PlaceRecognizer(), KeyframeDatabase(settings.keyframe_database_mb * MEGABYTE), PoseGraph()
    )


def create_loop_closer_from_map(contents: MapContents, settings: MapConfig) -> LoopCloser:
    """A loop closer that knows the places of a map that was kept.

    Its worlds get negative numbers: those of today are counted from 0.
    """
    worlds = sorted({place.world_id for place in contents.keyframes})
    today = {world: rank - len(worlds) for rank, world in enumerate(worlds)}
    places = KeyframeDatabase(settings.keyframe_database_mb * MEGABYTE)
    for place in contents.keyframes:
        places.add(replace(place, world_id=today[place.world_id]))
    nodes = (replace(node, world_id=today[node.world_id]) for node in contents.nodes)
    graph = PoseGraph(nodes, contents.edges)
    return LoopCloser(PlaceRecognizer(), places, graph, contents.next_number)
