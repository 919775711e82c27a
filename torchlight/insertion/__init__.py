"""An object into a photograph by the light recovered from it, and photographs under another light; see `rendering`."""
