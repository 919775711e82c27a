"""`torchlight.threads` under its former name."""

from torchlight.threads import ordered_map, single_threaded, thread_count

__all__ = ["ordered_map", "single_threaded", "thread_count"]
