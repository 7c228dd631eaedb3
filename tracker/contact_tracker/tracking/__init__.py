"""From ticks to beliefs, online and offline."""
