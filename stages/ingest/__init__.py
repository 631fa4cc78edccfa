"""Stages 1 and 2: scene and models become tiles in metres."""
