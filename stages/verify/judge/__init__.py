"""From evidence to scored hypotheses."""
