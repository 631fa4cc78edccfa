"""Where a model fits best."""
