"""Errors meant for a person: what is wrong, where, and what to do, in one line."""


class UserFacingError(Exception):
    """Something failed while running. Its text is the one line that a user reads."""

    exit_code = 1


class InputError(UserFacingError):
    """What the user gave (a file, a key, an argument) is wrong. Trying again will not help."""

    exit_code = 2


class CameraError(UserFacingError):
    """The camera cannot deliver. Trying again later may help."""


class CameraNotFoundError(CameraError):
    """No such camera is there now; it may be plugged in later."""


class CameraLostError(CameraError):
    """The camera was delivering and has stopped (unplugged, crashed)."""
