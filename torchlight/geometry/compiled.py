"""`torchlight.compiled` under its former name."""

from torchlight.compiled import ANNOUNCEMENT, compiled

__all__ = ["ANNOUNCEMENT", "compiled"]
