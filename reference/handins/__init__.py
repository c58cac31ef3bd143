"""Hand-ins of a course: which mistake draws a picture, and how two pictures differ."""
