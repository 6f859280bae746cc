"""Pictures of matches and epipolar lines."""
