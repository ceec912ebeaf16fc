"""What both packages use: geometry, errors, files, configuration, queues and processes."""
