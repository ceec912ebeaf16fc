"""Any camera in a process of its own that can be killed and restarted."""
