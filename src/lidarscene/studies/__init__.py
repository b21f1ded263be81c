"""Questions about sensors: how far they see and why, what a pattern covers, who finds more. Few of them trace."""
