"""Stage 2: which way is up, and where the ground is."""
