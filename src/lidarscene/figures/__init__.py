"""Pictures, charts and pages.

Drawing is kept apart from computing: a study returns numbers, and a module here draws them. matplotlib is imported
inside functions, so that nothing else waits for it.

lines        line charts
maps         maps over angles, patterns, the ground from above
panels       panels side by side, and the picture of a scene
intervals    values with intervals over bins or names
canvas       pixels and texts, written as PNG or SVG
pictures     pictures of point clouds
report       headings, paragraphs, tables and figures as text, Markdown, HTML, JSON and CSV
"""
