"""What is true of a picture: renderers and proofs that the tracer is held against."""
