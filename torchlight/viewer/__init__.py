"""An interactive look at a scene and its light; `window` is all that knows of viser."""
