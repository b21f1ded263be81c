"""What designers ask of a sensor without tracing anything: ranges, and what limits them."""
