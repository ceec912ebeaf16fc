"""A name for everything that changes a run: the same key, the same result."""

import hashlib
import json
from collections.abc import Iterator, Mapping

from drivers.errors import InputError
from vo_service.runs.listening import NOBODY, ListenerRecipe
from vo_service.runs.recipe import Recipe
from vo_service.runs.sequence import Recording


def run_key(
    recording: Recording,
    recipe: Recipe,
    versions: Mapping[str, str],
    listener: ListenerRecipe = NOBODY,
) -> str:
    """Digest of the versions, the settings, the camera and the recording's files.

    Images count by name, size and time of their last change; the ground truth where it is used.
    Raises InputError if a file has gone.
    """
    content = {
        "versions": dict(versions),
        "settings": {**recipe.settings, **listener.settings},
        "camera": repr(recording.opened.camera_file),
        "frames": list(_frames(recording)),
        "truth": _truth(recording) if recipe.uses_truth else None,
    }
    text = json.dumps(content, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()


def _frames(recording: Recording) -> Iterator[tuple[str, str, int, int]]:
    for pair in recording.opened.frames.pairs:
        for image in (pair.colour, pair.depth):
            try:
                state = image.file.stat()
            except FileNotFoundError:  # this frame will be skipped, as every time
                yield str(image.stamp), image.file.name, 0, 0
                continue
            except OSError as error:
                raise InputError(f"{image.file}: cannot be read: {error.strerror}") from error
            yield str(image.stamp), image.file.name, state.st_size, state.st_mtime_ns


def _truth(recording: Recording) -> str:
    truth = recording.truth
    if truth is None:
        return ""
    data = truth.stamps_s.tobytes() + truth.T_world_camera.tobytes()
    return hashlib.sha256(data).hexdigest()
