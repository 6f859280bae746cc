"""Collections: features once, pairs on workers, what is ready on disk; COLMAP databases and models, hloc files."""
