"""Structure from motion by color alone: the steps of `SfmOdometry`, one file each."""
