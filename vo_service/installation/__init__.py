"""kinect-vo as a service of the system: what is written where, and how it is taken away again."""
