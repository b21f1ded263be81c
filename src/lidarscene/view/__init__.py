"""Clouds and scenes in the browser: one page, served here or saved as a file.

A saved page must allow clicking, colouring and filtering without a server, and no viewer library's export can do
that. So the page is 900 lines of plain JavaScript and WebGL (static/), which works in both forms and loads nothing
from elsewhere.

page_sources  what is shown: files, or a scene to render
point_fields  a cloud as a blob
solid         a scene as shaded triangles
blob          header and arrays as bytes
controls      the sliders, and what they change
html_page     the page as one file
serve         the server, on this machine only
notebook      the page inside of a notebook's cell
widget        the same, live
"""
