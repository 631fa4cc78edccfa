"""From hypotheses to fates."""
