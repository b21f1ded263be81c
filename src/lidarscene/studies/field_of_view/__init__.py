"""Study what a scan pattern covers: how densely, how soon and how far.

Spinning, mirror and prism scanners are compared by the share of the field of view that they have covered within a time
and by the time until they return to a direction, which data sheets do not say.

field_of_view_study    entry point: from sensors to pictures, CSV and a page
study_options          settings of a study
sensor_view            the results for one sensor
pattern_coverage       pulses of a scanner; coverage, density and revisit time of each cell
sphere_cells           cells of equal solid angle on the sphere of directions
spacing                angles between neighbouring pulses
reach                  range over the field of view, and the ground around the vehicle that sensors see
body_points            points on each body of a scene against its distance; the only part that traces
field_of_view_figures  maps and charts
"""
