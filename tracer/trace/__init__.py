"""From samples to radiance: visibility, shadows, shading."""
