"""Uses of the simulator: fits, data sets, cost studies, clusters, the studio. Only commands import them."""
