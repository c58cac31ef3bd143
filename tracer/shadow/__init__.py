"""Which lights reach a point."""
