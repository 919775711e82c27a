"""Light as other programs want it: per target one module, a pure function from a light to pictures and texts."""
