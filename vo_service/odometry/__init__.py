"""The method, pure: frames in, estimates out. No file, no clock, no thread."""
