"""Making the loops: where they are asked for, since their libraries are slow to load."""

from dataclasses import replace

from vo_service.mapping.graph.pose_graph import PoseGraph
from vo_service.mapping.loops.inline import InlineLoops
from vo_service.mapping.loops.loop_closer import LoopCloser
from vo_service.mapping.places.map_file import MapContents
from vo_service.mapping.places.places import Places
from vo_service.mapping.places.recognition import Recogniser
from vo_service.settings import MEGABYTE, MapSettings


def open_inline_loops(settings: MapSettings) -> InlineLoops:
    """Loops on the caller's own thread, that know no place yet."""
    return InlineLoops(new_closer(settings))


def new_closer(settings: MapSettings) -> LoopCloser:
    """A loop closer that knows no place yet."""
    return LoopCloser(Recogniser(), Places(settings.places_mb * MEGABYTE), PoseGraph())


def closer_in(contents: MapContents, settings: MapSettings) -> LoopCloser:
    """A loop closer that knows the places of a map that was kept.

    Its worlds get negative numbers: those of today are counted from 0.
    """
    worlds = sorted({place.world for place in contents.places})
    today = {world: rank - len(worlds) for rank, world in enumerate(worlds)}
    places = Places(settings.places_mb * MEGABYTE)
    for place in contents.places:
        places.add(replace(place, world=today[place.world]))
    nodes = (replace(node, world=today[node.world]) for node in contents.nodes)
    graph = PoseGraph(nodes, contents.edges)
    return LoopCloser(Recogniser(), places, graph, contents.next_number)
