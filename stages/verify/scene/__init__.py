"""The points around candidates."""
