"""Errors for users: one line with what is wrong, where, and what to do."""


class UserFacingError(Exception):
    """A failure at run time. The CLI prints the text as one line."""

    exit_code = 1


class InputError(UserFacingError):
    """A wrong file, key or argument from the user. Trying again does not help."""

    exit_code = 2


class CameraError(UserFacingError):
    """The camera cannot deliver frames. Trying again later may help."""


class CameraNotFoundError(CameraError):
    """The camera is not connected; it may be plugged in later."""


class CameraLostError(CameraError):
    """The camera has stopped delivering (unplugged, crashed)."""
