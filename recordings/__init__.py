"""Configs that ship: ``spinpipe init --preset`` writes them."""
