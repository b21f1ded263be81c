"""Comparison of sensors on one scene: who finds which surface, and how well."""
