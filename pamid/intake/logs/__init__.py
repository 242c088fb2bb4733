"""Raw logs in: readers, a mapping, the time base, units; out come recordings."""
