"""From grains of light to the wave on a recording plane."""
