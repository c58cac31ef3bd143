"""The camera, and the nearest surface along each of its rays."""
