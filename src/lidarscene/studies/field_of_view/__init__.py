"""What a scan pattern covers, how densely, how soon and how far; of one sensor or of several on a vehicle."""
