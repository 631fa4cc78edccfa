"""From messages to Rerun entities."""
