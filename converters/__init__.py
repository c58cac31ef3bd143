"""Taking scenes on into Mitsuba 3, and holding the tracer against it."""
