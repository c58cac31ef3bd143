"""Materials, and the radiance of what is seen."""
