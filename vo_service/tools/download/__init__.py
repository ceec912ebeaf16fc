"""Download of recordings, of ``kinect-vo download``."""
