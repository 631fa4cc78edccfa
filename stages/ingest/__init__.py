"""Stage 1: scene and models become tiles in metres."""
