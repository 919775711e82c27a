"""How far a light is from another: docs/metrics.md has every formula."""
