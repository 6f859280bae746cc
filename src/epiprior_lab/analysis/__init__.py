"""What each step adds, and what limits the results (paper, section Analysis)."""
