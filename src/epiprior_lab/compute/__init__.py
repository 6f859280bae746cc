"""Tasks over pairs on processes or a cluster, their stored results, and seeds."""
