"""Readers of scenes and meshes: one a file format, chosen by what the file holds."""
