"""Scenes that are made: artificial, planted, cut out."""
