"""Ground truth of matches, and control points placed by hand."""
