"""Pictures, charts and pages.

Drawing is kept apart from computing: a study returns numbers, and a module here draws them. matplotlib is imported
inside functions, so that nothing else waits for it.

lines      line charts
maps       maps over angles, patterns, the ground from above
intervals  values with intervals over bins or names
pictures   pictures of point clouds
page       headings, paragraphs, pictures and tables as Markdown and HTML
"""
