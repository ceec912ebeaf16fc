"""The command line of ``kinect-vo``: a file per command."""
