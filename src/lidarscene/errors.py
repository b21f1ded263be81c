"""Errors: mistakes of the user or of the machine, each told in one plain message."""


class LidarSceneError(Exception):
    """A mistake of the user or the machine: what, where (file and key), what came, what was expected.

    The message is the whole story, without a traceback: the command line prints
    ``lidarscene: error: <message>`` and returns `exit_code`.
    """

    exit_code = 1


class InputError(LidarSceneError):
    """Raised when a file, a key or a value cannot be understood."""

    exit_code = 2


class OutputError(LidarSceneError):
    """Raised when a result cannot be written."""

    exit_code = 2


class BackendError(LidarSceneError):
    """Raised when Mitsuba has no back end (CUDA or LLVM) that works on this machine."""

    exit_code = 3
