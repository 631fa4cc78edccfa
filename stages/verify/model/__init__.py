"""A model prepared for look-ups."""
