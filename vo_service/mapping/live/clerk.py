"""What became of the maps that were to be saved or loaded, and what went wrong with them."""

import logging
import threading
from collections.abc import Callable
from dataclasses import replace
from re import fullmatch

from drivers.isolation.messages import LogLine
from vo_service.background.keeper import Helper, Keeper
from vo_service.background.trouble import Trouble
from vo_service.mapping.live.maps_folder import MapsFolder
from vo_service.mapping.live.messages import (
    Facts,
    Job,
    LoadMap,
    MapEnded,
    MapLoaded,
    SaveMap,
    Word,
)
from vo_service.odometry.relocalising import Located
from vo_service.settings import MapSettings
from vo_service.types import NAME_PATTERN, CommandError, ErrorCode, MapSnapshot, MapState

logger = logging.getLogger(__name__)

NAME = "map"
HELPER = Helper("vo_service.mapping.live.child", NAME)


class MapClerk:
    """Passes on what is asked for, at once; refuses what cannot be. Safe from any thread."""

    def __init__(
        self,
        job: Job,
        hear: Callable[[MapSnapshot | Located], None],
        look_anew: Callable[[], None],
        begin_anew: Callable[[], int],
    ) -> None:
        """`hear` gets what the process says of places.

        `look_anew` is called when a map has been loaded, `begin_anew` when all is lost: the number
        of the next frame that counts.
        """
        self._folder = MapsFolder(job.maps)
        self._hear_of_places = hear
        self._look_anew, self._begin_anew = look_anew, begin_anew
        self._lock = threading.Lock()
        self._taken: frozenset[str] = frozenset()
        self._with_places: frozenset[str] = frozenset()
        self._maps, self._folders, self._loads = Trouble(NAME), Trouble(NAME), Trouble(NAME)
        self._process_trouble = ""
        self.state = MapState()
        with self._lock:  # a process that dies at once waits until there is a keeper
            self._keeper = Keeper(HELPER, job, self._hear, self._died)

    @property
    def is_up(self) -> bool:
        """Whether the process takes orders."""
        return self._keeper.is_up

    @property
    def warning(self) -> str:
        """One clause; "" while all is well."""
        if self._keeper.is_up and self._keeper.is_silent:
            return f"{NAME}: its process does not answer; is the disk hung?"
        troubles = (
            self._process_trouble, self._maps.text, self._folders.text, self._loads.text
        )  # fmt: skip
        trouble = "; ".join(filter(None, troubles))
        return f"{NAME}: {trouble}" if trouble else ""

    def save(self, name: str) -> MapState:
        """Have a map made. Raises CommandError if that cannot be."""
        _check_name(name)
        with self._lock:
            self._check_answers()
            if self.state.saving:
                raise _not_possible(f"a map is being made already: {self.state.saving}")
            if name in self._taken:
                raise _not_possible(f"there is a map {name!r} already; give another name")
            if not self.state.keyframes:
                raise _not_possible("the map is empty: no frame has been tracked yet")
            self._maps.note("")
            self.state = replace(self.state, saving=str(self._folder.file(name)))
            self._keeper.tell(SaveMap(name))
            return self.state

    def load(self, name: str) -> MapState:
        """Have the places of a map loaded. Raises CommandError if that cannot be."""
        _check_name(name)
        with self._lock:
            self._check_answers()
            if self.state.loading:
                raise _not_possible(f"a map is being loaded already: {self.state.loading}")
            if name not in self._with_places:
                known = ", ".join(sorted(self._with_places)) or "none"
                raise _not_possible(f"there is no map {name!r} with places; there are: {known}")
            self._loads.note("")
            self.state = replace(self.state, loading=str(self._folder.places_file(name)))
            self._keeper.tell(LoadMap(name))
            return self.state

    def configure(self, settings: MapSettings) -> None:
        """For the keyframes from now on, and the next map."""
        self._keeper.job = replace(self._keeper.job, settings=settings)
        self._keeper.tell(settings)

    def close(self) -> None:
        """End the process; a map that is being made is given up."""
        self._keeper.close()
        if self.state.saving:
            logger.warning("%s: the service ends; %s is given up", NAME, self.state.saving)

    def _hear(self, word: Word) -> None:
        match word:
            case Facts(keyframes, maps, places, trouble):
                with self._lock:
                    self._taken, self._with_places, self._process_trouble = maps, places, ""
                    self.state = replace(self.state, keyframes=keyframes)
                self._folders.note(trouble)
            case MapEnded():
                self._take_ended(word)
            case MapLoaded():
                self._take_loaded(word)
            case MapSnapshot() | Located():
                self._hear_of_places(word)
            case LogLine(level, name, text):
                logging.getLogger(name).log(level, "%s: %s", NAME, text)

    def _take_ended(self, ended: MapEnded) -> None:
        file, trouble = ended.file, ended.trouble
        if not trouble:
            said = "%s: %s: %d triangles from %d keyframes"
            logger.info(said, NAME, file, ended.triangles, ended.keyframes)
        if ended.is_cut_off:
            trouble = f"{file} lacks what did not fit into map.making_mb; raise that or map.voxel_m"
        self._maps.note(trouble)
        with self._lock:
            saved = self.state.saved if ended.trouble else str(file)
            taken = self._taken if ended.trouble else self._taken | {file.stem}
            self._taken, self.state = taken, replace(self.state, saving="", saved=saved)

    def _take_loaded(self, loaded: MapLoaded) -> None:
        if not loaded.trouble:
            logger.info("%s: %s: %d places are known", NAME, loaded.file, loaded.places)
        self._loads.note(loaded.trouble)
        with self._lock:
            file = self.state.loaded if loaded.trouble else str(loaded.file)
            self.state = replace(self.state, loading="", loaded=file)
            if not loaded.trouble:  # a process that is started again begins in it as well
                settings = replace(self._keeper.job.settings, load=loaded.file.stem)
                self._keeper.job = replace(self._keeper.job, settings=settings)
        if not loaded.trouble:
            self._look_anew()

    def _check_answers(self) -> None:
        """Raises CommandError where orders would be lost. Called with the lock held."""
        if not self._keeper.is_up or self._keeper.is_silent:
            raise _not_possible("the map's process does not answer; try again in a moment")

    def _died(self) -> None:
        with self._lock:
            saving = self.state.saving
            self.state = replace(self.state, keyframes=0, saving="", loading="", loaded="")
            self._process_trouble = "its process ended and is started again; the map begins anew"
            self._keeper.job = replace(self._keeper.job, first=self._begin_anew())
        logger.warning("%s: %s", NAME, self._process_trouble)
        if saving:
            self._maps.note(f"{saving} was cut off")


def _check_name(name: str) -> None:
    if not fullmatch(NAME_PATTERN, name):
        raise CommandError(
            ErrorCode.BAD_REQUEST,
            "a map's name is up to 64 letters, digits, dots, dashes and underscores",
        )


def _not_possible(reason: str) -> CommandError:
    return CommandError(ErrorCode.NOT_POSSIBLE, reason)
