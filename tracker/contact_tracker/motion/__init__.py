"""From poses to ticks: validation, averaging, estimation of the noise, and the free-motion filter."""
