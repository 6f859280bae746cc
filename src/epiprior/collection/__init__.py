"""Collections: features once, pairs on processes or a cluster, what is ready on disk, models of COLMAP, files of hloc."""
