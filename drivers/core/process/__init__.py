"""Worker processes: `client` has the service's side, `service_connection` the worker's side."""
