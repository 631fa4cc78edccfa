"""Stage 5: hits become candidates."""
