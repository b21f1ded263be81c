"""Batch: many frames on many processes. A job file in; clouds, and a manifest with a row for each, out."""
