"""What judges pictures: independent tracers, and the parts of the certificate."""
