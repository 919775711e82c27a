"""The pictures of docs/capture.md that are drawn or rendered: where to stand, which object, what to avoid."""
