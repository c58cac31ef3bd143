"""References for pictures: renderers and proofs with which the tracer is compared."""
