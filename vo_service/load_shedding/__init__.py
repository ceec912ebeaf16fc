"""Load shedding: less work while the machine is too slow."""
