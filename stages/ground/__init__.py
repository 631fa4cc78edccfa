"""Stage 3: which way is up, and where the ground is."""
