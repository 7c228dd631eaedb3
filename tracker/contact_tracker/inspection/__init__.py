"""What a stream of poses shows of mistakes in recording it: units, bodies, filters."""
