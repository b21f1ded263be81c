"""Charts, maps, pictures and pages. The only folder that draws; matplotlib is imported when it is needed."""
