"""Errors a caller can act on: what is wrong, where, and what to do about it.

Every message is one line. The command line prints it and nothing else.
"""


class TorchlightError(Exception):
    """Base class of everything torchlight raises on purpose; a line break out of a file or a name becomes a space."""

    def __init__(self, message: str = "") -> None:
        super().__init__(" ".join(message.splitlines()))


class ShapeError(TorchlightError, ValueError):
    """A tensor has the wrong shape, dtype or device."""


class SceneError(TorchlightError, ValueError):
    """The scene cannot cast or receive a shadow as described."""


class CalibrationError(TorchlightError, ValueError):
    """The camera's intrinsics, distortion or pose cannot be right."""


class ConfigError(TorchlightError, ValueError):
    """A setting is unknown, out of range, or contradicts another."""


class FormatError(TorchlightError, OSError):
    """A file is missing, unreadable, truncated or not what its name says."""


class SolveError(TorchlightError, RuntimeError):
    """A solve did not give a usable answer; `Solution.check` raises it."""


class TorchlightWarning(UserWarning):
    """Something a user should know that does not stop the work."""
