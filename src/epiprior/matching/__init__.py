"""Standard matches, roll, clusters and putative matches (paper, sections 4.1 to 4.3)."""
