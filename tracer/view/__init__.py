"""What is seen: the camera, and the nearest surface along each of its rays."""
