"""Images, points and acceleration over Zenoh, each only while somebody subscribes."""
