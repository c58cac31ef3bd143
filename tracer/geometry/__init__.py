"""The camera, and what it sees of spheres and boxes."""
