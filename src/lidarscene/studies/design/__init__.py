"""Search for the best lidar: free keys of sensor files, objectives, constraints; a front of designs comes out.

`study_file` is what people write, `designs` turns a point of the search into sensors, `quantities` computes what is
asked of them, `search` looks for the best, `optimum` says what limits it, and `design_report` writes the result.
"""
