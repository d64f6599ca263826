"""Fields on planes: their propagation, their phases, and the optimization of both."""
