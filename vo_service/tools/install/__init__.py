"""Installation of the program, its systemd units and its udev rules."""
