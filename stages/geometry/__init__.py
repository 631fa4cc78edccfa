"""What several stages share and that knows no stage."""
