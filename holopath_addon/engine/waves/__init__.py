"""Fields on planes: how they propagate, their phases, and how both are found by descent."""
