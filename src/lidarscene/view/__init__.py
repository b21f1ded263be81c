"""View: clouds and scenes in, a page in the browser out, served on this machine or in one file."""
