"""Streets made from a seed: what stands along them, who drives and walks there, and the scene file of both."""
