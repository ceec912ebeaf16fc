"""The subcommands of kinect-vo, one file each."""
