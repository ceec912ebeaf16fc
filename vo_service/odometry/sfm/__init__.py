"""Structure from motion by color only: the steps of `SfmOdometry`, one file each."""
