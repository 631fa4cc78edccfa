"""What speaks for and against a model at a pose."""
