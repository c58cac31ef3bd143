"""Tools that validate the tracer; a module with a `main` is a command."""
