"""One file per comparison. Its function ``measure`` takes the options and yields records."""
