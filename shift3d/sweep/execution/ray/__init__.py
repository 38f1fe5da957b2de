"""Ray workers: connection, worker pool, calls in flight, failures and hangs."""
