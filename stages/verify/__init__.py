"""Stage 6: what stands at each candidate, and how sure that is."""
