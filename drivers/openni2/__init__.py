"""PrimeSense and Xtion sensors and .oni recordings through OpenNI2."""
