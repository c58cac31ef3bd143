"""Tools that hold the tracer against others; a module with a `main` is a command."""
