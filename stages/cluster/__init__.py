"""Stage 4: hits become candidates."""
